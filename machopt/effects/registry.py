"""Every effect, from one explicit list."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from machopt.effects import (
    backlash,
    base,
    by_angle,
    compensator,
    coupling,
    creep,
    delay,
    friction,
    geometric,
    geometry,
    hardening,
    hysteresis,
    kinematic,
    link,
    payload,
    record,
    sensor,
    thermal,
    tool,
    vibration,
)
from machopt.effects.protocol import Effect, Unloaded

LISTED = (
    link.EFFECT,
    base.EFFECT,
    tool.EFFECT,
    coupling.ELASTIC,
    hardening.EFFECT,
    backlash.EFFECT,
    hysteresis.EFFECT,
    creep.EFFECT,
    by_angle.EFFECT,
    compensator.EFFECT,
    geometric.GEOMETRIC,
    payload.PAYLOAD,
    kinematic.ZERO,
    kinematic.WAVES,
    coupling.KINEMATIC,
    geometry.EFFECT,
    friction.EFFECT,
    delay.LAG,
    vibration.VIBRATION,
    thermal.THERMAL,
    sensor.OFFSET,
    sensor.GAIN,
    sensor.FRAME,
    sensor.DISPLACEMENT,
    sensor.LOAD,
    record.UNITS,
    record.COLUMNS,
    delay.CLOCK,
    record.OUTLIERS,
)


def registry(effects: Iterable[Effect]) -> Mapping[str, Effect]:
    """Effects by name, in order.

    Raises:
        ValueError: a name that stands twice, or a word twice among what is elastic or what is not.
    """
    out: dict[str, Effect] = {}
    seen: set[tuple[str, bool]] = set()
    for effect in effects:
        word = (effect.called, effect.elastic)
        if effect.name in out or word in seen:
            raise ValueError(f"the effect {effect.name if effect.name in out else effect.called!r} stands twice")
        out[effect.name] = effect
        seen.add(word)
    return MappingProxyType(out)


EFFECTS = registry(LISTED)


def known(word: str) -> Effect | None:
    """The effect that files and findings mean by a word, the first where two share it; None of a user's own."""
    return EFFECTS.get(word) or next((e for e in EFFECTS.values() if e.called == word), None)


def elastic(word: str) -> Effect:
    """The effect that stiffness.yaml means by a word that it may use."""
    return next(e for e in EFFECTS.values() if e.elastic and e.called == word)


def without_load() -> Mapping[str, tuple[Effect, Unloaded]]:
    """What kinematics.yaml can hold, by the words it uses."""
    return {e.called: (e, e.unloaded[0]) for e in EFFECTS.values() if e.unloaded}


def of_angles(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that a joint is off by without any load, in the order in which a search tries them."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.unloaded)


def of_joint_torque(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that twist a joint by its own torque, in the order in which a search tries them."""
    listed = (EFFECTS if effects is None else effects).values()
    return tuple(e for e in listed if e.laws and not e.paired)


def of_joint_pairs() -> tuple[Effect, ...]:
    """Those that twist each of two joints by the torque of the other."""
    return tuple(e for e in EFFECTS.values() if e.laws and e.paired)


def of_beside(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that put a torque on a joint beside its gear."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.beside)


def of_bodies(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that give way under the wrench that a body bears, in the order in which a search tries them."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.gives)


def of_records(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that are wrong with forces or displacements of a record."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.recorded)


def of_friction(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that a motor works against in motion."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.rubs)


def of_motors(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those of what drives tell beyond what each joint asks of its own motor."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.motors)


def of_drifts(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that move arm or set-up with time or temperature."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.drifts)


def of_flange(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those of what the tool side carries."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.carries)


def of_swings(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that swing on a joint's spring."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.swings)


def of_clocks(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those of a channel that comes late in the record."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.delays and e.port == "record")


def of_followers(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those of an arm that comes behind its command."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.delays and e.port != "record")
