"""Faults of a recording that do not concern the arm: units, columns, single rows.

Names, places and typical wrong units. The corrections use them
(:mod:`machopt.measurement.diagnosis.data_quality.correction_candidates`,
:mod:`machopt.measurement.diagnosis.data_quality.static_record_correction`,
:mod:`machopt.measurement.identification.data_quality.unit_checks`). Sensor errors:
:mod:`machopt.effects.recording.sensor_errors`. Delays: :mod:`machopt.effects.recording.time_delay`.
"""

from __future__ import annotations

from machopt.data_types.effect_locations import MOST_JOINTS, format_column_location
from machopt.effects.joint.drive_gain import DriveGainError
from machopt.effects.protocol import Effect

LENGTHS = {"inches": 25.4, "centimetres": 10.0, "metres": 1e3, "micrometres": 1e-3}  # millimetres in one
ANGLES = {"radians": 57.29577951308232, "turns": 360.0, "gon": 0.9}  # degrees in one
MOMENTS = {
    "kN·m": 1e3,
    "kgf·m": 9.80665,
    "lbf·ft": 1.3558179483,
}  # newton metres in one; newton millimetres are detected as lever arms
FORCES = {"kilograms": 9.80665, "pounds": 4.44822, "kilonewtons": 1e3}  # newtons in one

UNITS = Effect(
    name="units",
    noun="wrong unit",
    short_noun="units",
    sentence="The column carries another unit than its name says, or another share of it.",
    port="record",
    places=(),
    preferred_places=tuple(format_column_location(f"tau{n}_Nm") for n in range(1, MOST_JOINTS + 1)),
    motor_laws=(DriveGainError(),),
    plausible_sizes={"%": 60.0},
    preposition="in",
)

COLUMNS = Effect(
    name="columns",
    noun="wrong columns",
    short_noun="columns",
    sentence="Signs, axes or rows of the columns are exchanged.",
    port="record",
    places=(),
    preposition="in",
)

OUTLIERS = Effect(
    name="outliers",
    noun="outliers",
    short_noun="outlying rows",
    sentence="Single readings that no physics explains: slips, slipped decimals, lost beams.",
    port="record",
    places=(),
    preposition="in",
)
