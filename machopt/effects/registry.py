"""Every effect, from one explicit list."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from machopt.effects.joint import (
    angle_dependent_stiffness,
    backlash,
    creep,
    friction,
    gravity_compensator,
    hysteresis,
    joint_angle_errors,
    joint_coupling,
    joint_vibration,
    nonlinear_stiffness,
)
from machopt.effects.protocol import Effect, JointAngleLaw
from machopt.effects.recording import record_faults, sensor_errors, time_delay
from machopt.effects.structure import (
    base_compliance,
    geometric_stiffness,
    link_compliance,
    link_geometry,
    payload,
    thermal_drift,
    tool_compliance,
)

ALL_EFFECTS = (
    link_compliance.EFFECT,
    base_compliance.EFFECT,
    tool_compliance.EFFECT,
    joint_coupling.ELASTIC,
    nonlinear_stiffness.EFFECT,
    backlash.EFFECT,
    hysteresis.EFFECT,
    creep.EFFECT,
    angle_dependent_stiffness.EFFECT,
    gravity_compensator.EFFECT,
    geometric_stiffness.GEOMETRIC,
    payload.PAYLOAD,
    joint_angle_errors.ZERO,
    joint_angle_errors.WAVES,
    joint_coupling.KINEMATIC,
    link_geometry.EFFECT,
    friction.EFFECT,
    time_delay.COMMAND_DELAY_EFFECT,
    joint_vibration.VIBRATION,
    thermal_drift.THERMAL,
    sensor_errors.OFFSET,
    sensor_errors.GAIN,
    sensor_errors.FRAME,
    sensor_errors.DISPLACEMENT,
    sensor_errors.LOAD,
    record_faults.UNITS,
    record_faults.COLUMNS,
    time_delay.CLOCK_EFFECT,
    record_faults.OUTLIERS,
)


def build_registry(effects: Iterable[Effect]) -> Mapping[str, Effect]:
    """Effects by name, in order.

    Raises:
        ValueError: a name that stands twice, or a word twice among what is elastic or what is not.
    """
    out: dict[str, Effect] = {}
    seen: set[tuple[str, bool]] = set()
    for effect in effects:
        word = (effect.file_word, effect.is_elastic)
        if effect.name in out or word in seen:
            raise ValueError(f"the effect {effect.name if effect.name in out else effect.file_word!r} stands twice")
        out[effect.name] = effect
        seen.add(word)
    return MappingProxyType(out)


EFFECTS = build_registry(ALL_EFFECTS)


def find_effect(word: str) -> Effect | None:
    """The effect that files and findings mean by a word, the first where two share it; None of a user's own."""
    return EFFECTS.get(word) or next((e for e in EFFECTS.values() if e.file_word == word), None)


def find_elastic_effect(word: str) -> Effect:
    """The effect that stiffness.yaml means by a word that it may use."""
    return next(e for e in EFFECTS.values() if e.is_elastic and e.file_word == word)


def list_angle_effects_by_word() -> Mapping[str, tuple[Effect, JointAngleLaw]]:
    """What kinematics.yaml can hold, by the words it uses."""
    return {e.file_word: (e, e.angle_laws[0]) for e in EFFECTS.values() if e.angle_laws}


def select_angle_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that a joint is off by without any load, in the order in which a search tries them."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.angle_laws)


def select_joint_torque_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that twist a joint by its own torque, in the order in which a search tries them."""
    listed = (EFFECTS if effects is None else effects).values()
    return tuple(e for e in listed if e.joint_laws and not e.is_joint_pair)


def select_joint_pair_effects() -> tuple[Effect, ...]:
    """Those that twist each of two joints by the torque of the other."""
    return tuple(e for e in EFFECTS.values() if e.joint_laws and e.is_joint_pair)


def select_parallel_torque_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that put a torque on a joint beside its gear."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.parallel_torque_laws)


def select_body_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that give way under the wrench that a body bears, in the order in which a search tries them."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.body_laws)


def select_record_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that are wrong with forces or displacements of a record."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.record_laws)


def select_friction_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that a motor works against in motion."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.friction_laws)


def select_motor_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those of what drives tell beyond what each joint asks of its own motor."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.motor_laws)


def select_drift_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that move arm or set-up with time or temperature."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.drift_laws)


def select_payload_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those of what the tool side carries."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.payload_laws)


def select_vibration_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that swing on a joint's spring."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.vibration_laws)


def select_channel_delay_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those of a channel that comes late in the record."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.delay_laws and e.port == "record")


def select_command_delay_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those of an arm that comes behind its command."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.delay_laws and e.port != "record")
