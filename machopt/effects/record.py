"""What is wrong with a recording and not with the arm: sensors, units, clocks, single rows."""

from __future__ import annotations

from machopt.effects.protocol import Effect

OFFSET = Effect(
    name="force_sensor_offset",
    noun="zero offset",
    spoken="zero of the force sensor",
    sentence="The force sensor shows a load where none acts.",
    port="record",
    places=("sensor:force",),
)

GAIN = Effect(
    name="force_sensor_gain",
    noun="gain",
    spoken="gain of the force sensor",
    sentence="The force sensor reads a share too much or too little.",
    port="record",
    places=("sensor:force",),
    plausible={"%": 60.0},
)

FRAME = Effect(
    name="force_sensor_frame",
    noun="misalignment",
    spoken="axes of the force sensor",
    sentence="The force sensor's axes are turned against the recorded frame.",
    port="record",
    places=("sensor:force",),
    plausible={"deg": 25.0},
)

DISPLACEMENT = Effect(
    name="displacement_frame",
    noun="misalignment",
    spoken="axes of the displacement",
    sentence="The measured displacements are turned against the recorded frame.",
    port="record",
    places=("sensor:displacement",),
    plausible={"deg": 25.0},
)

LOAD = Effect(
    name="load_geometry",
    noun="load geometry",
    spoken="where or which way the load acted",
    sentence="The load acted elsewhere, or in another direction, than recorded.",
    port="record",
    places=("sensor:force",),
    plausible={"deg": 25.0, "mm": 1000.0},
    of="",
)

UNITS = Effect(
    name="units",
    noun="wrong unit",
    spoken="units",
    sentence="The column carries another unit than its name says.",
    port="record",
    places=(),
    of="in",
)

CLOCK = Effect(
    name="time_skew",
    noun="time skew",
    spoken="a clock that is off",
    sentence="The channel is early or late against the others.",
    port="record",
    places=(),
)

OUTLIERS = Effect(
    name="outliers",
    noun="outliers",
    spoken="outlying rows",
    sentence="Single readings that no physics explains: slips, slipped decimals, lost beams.",
    port="record",
    places=(),
    of="in",
)
