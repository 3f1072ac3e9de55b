"""Entries of kinematics.yaml: from a law's numbers, and what was found on top of what is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from machopt.arrays import Array
from machopt.domain.kinematics import KinematicCorrection, Kinematics
from machopt.effects import files, geometry, registry, within
from machopt.effects.protocol import Effect


def entry(
    effect: Effect, location: str, values: Array, shape: Array, more: Mapping[str, Any] | None = None
) -> KinematicCorrection:
    """What kinematics.yaml states of an effect of port angle, with keys that are no numbers of its law."""
    law = effect.unloaded[0]
    stated = files.write(law, values, shape)
    keys = [p.key for p in (*law.shape, *law.coefficients)]
    return KinematicCorrection(effect.called, location, {key: stated[key] for key in keys} | dict(more or {}))


def extended(known: Kinematics | None, found: Iterable[KinematicCorrection]) -> Kinematics:
    """The corrections known so far and what was found on top of them.

    At one place zero offsets, couplings and geometry add up; waves stand beside each other, the same order adds up.
    Waves of another range of angles are an entry of their own.
    """
    out: dict[tuple[str, str, tuple[float, ...]], KinematicCorrection] = {}
    laws = registry.without_load()
    for c in (*(known.corrections if known else ()), *found):
        key = c.effect, c.location, tuple(c.parameters.get(within.KEY, ()))
        old = out.get(key)
        if old is not None and c.effect == geometry.EFFECT.name:
            both = geometry.summed(old.parameters, c.parameters)
            out[key] = KinematicCorrection(c.effect, c.location, both)
        elif old is not None:
            both = files.summed(laws[c.effect][1], old.parameters, c.parameters)
            kept = {within.KEY: c.parameters[within.KEY]} if within.KEY in c.parameters else {}
            out[key] = KinematicCorrection(c.effect, c.location, both | kept)
        else:
            out[key] = c
    return Kinematics(tuple(out.values()))
