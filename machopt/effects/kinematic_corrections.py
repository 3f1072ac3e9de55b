"""Entries of kinematics.yaml: built from a law's numbers, and merged with known entries."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.effects import measured_angle_range, parameter_conversion, registry
from machopt.effects.protocol import Effect
from machopt.effects.structure import as_built_joint_frames
from machopt.numerics.array_types import Array


def build_kinematic_correction(
    effect: Effect, location: str, values: Array, shape: Array, more: Mapping[str, Any] | None = None
) -> KinematicCorrection:
    """Build the entry of kinematics.yaml for an effect of port angle.

    Args:
        effect: Effect with at least one angle law.
        location: Place of the effect, for example ``joint:3``.
        values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
        shape: (S,) shape parameters of the law, SI.
        more: Further keys of the entry that are not numbers of the law, for example the angle range.

    Returns:
        The entry.
    """
    law = effect.angle_laws[0]
    stated = parameter_conversion.write_law_parameters(law, values, shape)
    keys = [p.key for p in (*law.shape, *law.coefficients)]
    return KinematicCorrection(effect.file_word, location, {key: stated[key] for key in keys} | dict(more or {}))


def extend_kinematics(known: KinematicCorrections | None, found: Iterable[KinematicCorrection]) -> KinematicCorrections:
    """Combine known corrections with newly found ones.

    At the same place zero offsets, couplings and geometry add up. Harmonics are listed side by side, and equal orders
    add up. Harmonics with another angle range form an entry of their own.

    Args:
        known: Corrections known so far, or None.
        found: Corrections found relative to the known ones.

    Returns:
        All corrections.
    """
    out: dict[tuple[str, str, tuple[float, ...]], KinematicCorrection] = {}
    laws = registry.list_angle_effects_by_word()
    for c in (*(known.corrections if known else ()), *found):
        key = c.effect, c.location, tuple(c.parameters.get(measured_angle_range.RANGE_KEY, ()))
        existing = out.get(key)
        if existing is not None and c.effect == as_built_joint_frames.EFFECT.name:
            total = as_built_joint_frames.add_frame_offsets(existing.parameters, c.parameters)
            out[key] = KinematicCorrection(c.effect, c.location, total)
        elif existing is not None:
            total = parameter_conversion.add_law_parameters(laws[c.effect][1], existing.parameters, c.parameters)
            angle_range_entry = (
                {measured_angle_range.RANGE_KEY: c.parameters[measured_angle_range.RANGE_KEY]}
                if measured_angle_range.RANGE_KEY in c.parameters
                else {}
            )
            out[key] = KinematicCorrection(c.effect, c.location, total | angle_range_entry)
        else:
            out[key] = c
    return KinematicCorrections(tuple(out.values()))
