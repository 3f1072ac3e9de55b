"""Entries of kinematics.yaml: from a law's numbers, and what was found on top of what is known."""

from __future__ import annotations

from collections.abc import Iterable

from machopt.arrays import Array
from machopt.domain.kinematics import KinematicCorrection, Kinematics
from machopt.effects import files, geometry, registry
from machopt.effects.protocol import Effect


def entry(effect: Effect, location: str, values: Array, shape: Array) -> KinematicCorrection:
    """What kinematics.yaml states of an effect of port angle."""
    assert effect.unloaded is not None  # port angle
    stated = files.write(effect.unloaded, values, shape)
    keys = [p.key for p in (*effect.unloaded.shape, *effect.unloaded.coefficients)]
    return KinematicCorrection(effect.called, location, {key: stated[key] for key in keys})


def extended(known: Kinematics | None, found: Iterable[KinematicCorrection]) -> Kinematics:
    """The corrections known so far and what was found on top of them.

    At one place zero offsets, couplings and geometry add up; waves stand beside each other, the same order adds up.
    """
    out: dict[tuple[str, str], KinematicCorrection] = {}
    laws = registry.without_load()
    for c in (*(known.corrections if known else ()), *found):
        old = out.get((c.effect, c.location))
        if old is not None and c.effect == geometry.EFFECT.name:
            both = geometry.summed(old.parameters, c.parameters)
            out[c.effect, c.location] = KinematicCorrection(c.effect, c.location, both)
        elif old is not None:
            both = files.summed(laws[c.effect][1], old.parameters, c.parameters)
            out[c.effect, c.location] = KinematicCorrection(c.effect, c.location, both)
        else:
            out[c.effect, c.location] = c
    return Kinematics(tuple(out.values()))
