"""Every effect, from one explicit list."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from machopt.effects import (
    backlash,
    bodies,
    by_angle,
    compensator,
    coupling,
    creep,
    drive,
    environment,
    hardening,
    hysteresis,
    kinematic,
    load,
    record,
)
from machopt.effects.protocol import Effect

LISTED = (
    bodies.LINK, bodies.BASE, bodies.TOOL, coupling.EFFECT,
    hardening.EFFECT, backlash.EFFECT, hysteresis.EFFECT, creep.EFFECT, by_angle.EFFECT,
    compensator.EFFECT, load.GEOMETRIC, load.PAYLOAD,
    kinematic.ZERO, kinematic.WAVES,
    drive.FRICTION, drive.LAG, drive.VIBRATION, environment.THERMAL,
    record.OFFSET, record.GAIN, record.FRAME, record.DISPLACEMENT, record.LOAD, record.UNITS, record.CLOCK,
    record.OUTLIERS,
)  # fmt: skip


def registry(effects: Iterable[Effect]) -> Mapping[str, Effect]:
    """Effects by name, in order.

    Raises:
        ValueError: a name that stands twice.
    """
    out: dict[str, Effect] = {}
    for effect in effects:
        if effect.name in out:
            raise ValueError(f"the effect {effect.name!r} stands twice")
        out[effect.name] = effect
    return MappingProxyType(out)


EFFECTS = registry(LISTED)


def of_joint_torque(effects: Mapping[str, Effect] | None = None) -> tuple[Effect, ...]:
    """Those that twist a joint by its own torque, in the order in which a search tries them."""
    return tuple(e for e in (EFFECTS if effects is None else effects).values() if e.port == "twist" and e.laws)
