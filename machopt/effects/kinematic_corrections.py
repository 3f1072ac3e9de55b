"""Entries of kinematics.yaml: from a law's numbers, and what was found on top of what is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.effects import angle_range, parameter_conversion, registry
from machopt.effects.protocol import Effect
from machopt.effects.structure import link_geometry
from machopt.numerics.array_types import Array


def build_kinematic_correction(
    effect: Effect, location: str, values: Array, shape: Array, more: Mapping[str, Any] | None = None
) -> KinematicCorrection:
    """What kinematics.yaml states of an effect of port angle, with keys that are no numbers of its law."""
    law = effect.angle_laws[0]
    stated = parameter_conversion.write_law_parameters(law, values, shape)
    keys = [p.key for p in (*law.shape, *law.coefficients)]
    return KinematicCorrection(effect.file_word, location, {key: stated[key] for key in keys} | dict(more or {}))


def extend_kinematics(known: KinematicCorrections | None, found: Iterable[KinematicCorrection]) -> KinematicCorrections:
    """The corrections known so far and what was found on top of them.

    At one place zero offsets, couplings and geometry add up; waves stand beside each other, the same order adds up.
    Waves of another range of angles are an entry of their own.
    """
    out: dict[tuple[str, str, tuple[float, ...]], KinematicCorrection] = {}
    laws = registry.list_angle_effects_by_word()
    for c in (*(known.corrections if known else ()), *found):
        key = c.effect, c.location, tuple(c.parameters.get(angle_range.RANGE_KEY, ()))
        old = out.get(key)
        if old is not None and c.effect == link_geometry.EFFECT.name:
            both = link_geometry.add_frame_offsets(old.parameters, c.parameters)
            out[key] = KinematicCorrection(c.effect, c.location, both)
        elif old is not None:
            both = parameter_conversion.add_law_parameters(laws[c.effect][1], old.parameters, c.parameters)
            kept = (
                {angle_range.RANGE_KEY: c.parameters[angle_range.RANGE_KEY]}
                if angle_range.RANGE_KEY in c.parameters
                else {}
            )
            out[key] = KinematicCorrection(c.effect, c.location, both | kept)
        else:
            out[key] = c
    return KinematicCorrections(tuple(out.values()))
