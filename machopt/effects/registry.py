"""Registry of all effects, built from one explicit list."""

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
    as_built_joint_frames,
    base_compliance,
    geometric_stiffness,
    link_compliance,
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
    joint_angle_errors.CORRECTION,
    joint_coupling.KINEMATIC,
    as_built_joint_frames.EFFECT,
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
    """Build the registry of effects by name.

    Args:
        effects: Effects in the order in which a search tries them.

    Returns:
        Effects by name, in order.

    Raises:
        ValueError: A name occurs twice, or a file word occurs twice among elastic or among other effects.
    """
    out: dict[str, Effect] = {}
    seen: set[tuple[str, bool]] = set()
    for effect in effects:
        word = (effect.file_word, effect.is_elastic)
        if effect.name in out or word in seen:
            raise ValueError(f"the effect {effect.name if effect.name in out else effect.file_word!r} is given twice")
        out[effect.name] = effect
        seen.add(word)
    return MappingProxyType(out)


EFFECTS = build_registry(ALL_EFFECTS)


def find_effect(word: str) -> Effect | None:
    """Find the effect that files and findings mean by a word.

    Args:
        word: Name or file word; if two effects share it, the first one is returned.

    Returns:
        The effect; None for a user-defined effect.
    """
    return EFFECTS.get(word) or next((e for e in EFFECTS.values() if e.file_word == word), None)


def find_elastic_effect(word: str) -> Effect:
    """Find the effect that stiffness.yaml means by a word.

    Args:
        word: File word of an elastic effect.

    Returns:
        The effect.
    """
    return next(e for e in EFFECTS.values() if e.is_elastic and e.file_word == word)


def list_angle_effects_by_word() -> Mapping[str, tuple[Effect, JointAngleLaw]]:
    """Return the effects that kinematics.yaml can state, by file word."""
    return {e.file_word: (e, e.angle_laws[0]) for e in EFFECTS.values() if e.angle_laws}


def select_angle_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the effects with joint angle errors without load.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in the order in which a search tries them.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.angle_laws)


def select_joint_torque_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the effects that twist a joint by its own torque.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in the order in which a search tries them.
    """
    listed = (EFFECTS if effects is None else effects).values()
    return tuple(e for e in listed if e.joint_laws and not e.is_joint_pair)


def select_joint_pair_effects() -> tuple[Effect, ...]:
    """Return the effects that twist each of two joints by the torque of the other."""
    return tuple(e for e in EFFECTS.values() if e.joint_laws and e.is_joint_pair)


def select_parallel_torque_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the effects that apply a torque in parallel to the gear.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in registry order.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.parallel_torque_laws)


def select_body_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the effects of compliant bodies.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in the order in which a search tries them.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.body_laws)


def select_record_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the errors of recorded forces or displacements.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in registry order.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.record_laws)


def select_friction_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the effects of motor friction in motion.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in registry order.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.friction_laws)


def select_motor_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the effects of recorded drive torques beyond the joint's own motor model.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in registry order.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.motor_laws)


def select_drift_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the drifts of arm or set-up with time or temperature.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in registry order.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.drift_laws)


def select_payload_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the effects of the payload.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in registry order.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.payload_laws)


def select_vibration_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the vibrations of a joint on its own spring.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in registry order.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.vibration_laws)


def select_channel_delay_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the delays of a recorded channel.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in registry order.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.delay_laws and e.port == "record")


def select_command_delay_effects(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Select the delays of the arm behind its command.

    Args:
        effects: Registry to select from; None selects from the registered effects.

    Returns:
        Effects in registry order.
    """
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.delay_laws and e.port != "record")
