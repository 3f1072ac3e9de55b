"""TCP offset from the cell: once found, the diagnosis is repeated about the corrected TCP.

The law (:class:`machopt.effects.recording.sensor_errors.TcpOffset`) is linear in the offset. A tool that is 0.1 m
shorter rotates the arm about another point, and the second-order part would imitate tool compliance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from machopt.effects.recording.sensor_errors import LOAD, TcpOffset
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, EstimatedValue, Finding
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform

DiagnosedProblem = tuple[DiagnosisResult, DiagnosisProblem]
STEPS = 3  # iterations; each step is about a tenth of the previous one


def diagnose_about_found_tcp(
    T_flange_tcp: Array, look: Callable[[Array], DiagnosedProblem]
) -> tuple[DiagnosedProblem, Finding | None]:
    """Diagnose load tests about the TCP that they show.

    Args:
        T_flange_tcp: (4, 4) TCP of the cell.
        look: Function that diagnoses with a given TCP.

    Returns:
        The diagnosis with its problem, and the finding with the total offset; None if the cell's TCP fits as
        well.
    """
    first = d, _ = look(T_flange_tcp)
    found = again = _find_tcp_finding(d)
    if found is None:
        return first, None
    offset = np.zeros(3)
    for _ in range(STEPS):
        if again is None:
            break
        last, offset = again, offset + np.array([e.value for e in _list_offset_estimates(again)]) * 1e-3
        seen = there, _ = look(T_flange_tcp @ build_transform(np.eye(3), offset))
        again = _find_tcp_finding(there)
    fewer = there.verdict in ("consistent", "explained") and len(there.findings) < len(d.findings)
    if again is not None or not (fewer or there.heldout_after <= max(d.heldout_after, d.noise_floor)):
        return first, None
    parameters = _combine_offset_estimates(1e3 * offset, last)
    return seen, replace(found, parameters=parameters, before=d.heldout_before, after=there.heldout_after, record=True)


def describe_tcp_correction(T_flange_tcp: Array, found: Sequence[Finding]) -> list[str]:
    """Describe the TCP that the cell needs for the stiffness of such a diagnosis.

    Args:
        T_flange_tcp: (4, 4) TCP of the cell.
        found: Findings with TCP offsets.

    Returns:
        One sentence per finding.
    """
    out = []
    for f in found:
        offset = 1e-3 * np.array([e.value for e in _list_offset_estimates(f)])
        at = 1e3 * (T_flange_tcp @ build_transform(np.eye(3), offset))[:3, 3]
        xyz = ", ".join(f"{v:.1f}" for v in at)
        out.append(
            f"what is found, and stiffness.yaml, hold for a TCP at tool.tcp.xyz_mm: [{xyz}], where readings show it; "
            "put it into the cell with them, or put the record right"
        )
    return out


def _find_tcp_finding(d: DiagnosisResult) -> Finding | None:
    return next((f for f in d.findings if (f.effect, f.law) == (LOAD.name, TcpOffset.name)), None)


def _list_offset_estimates(f: Finding) -> list[EstimatedValue]:
    return [f.parameters[f"offset_{a}"] for a in "xyz"]


def _combine_offset_estimates(offset: Array, last: Finding) -> Mapping[str, EstimatedValue]:
    """Return the total offset (3,) mm with the uncertainty of the last step."""
    size = float(np.linalg.norm(offset))

    def ends(level: str) -> list[tuple[float, float]]:
        parts = [(getattr(e, level), e.value) for e in _list_offset_estimates(last)]
        each = [(v + low - was, v + high - was) for v, ((low, high), was) in zip(offset, parts, strict=True)]
        wide = np.array([(high - low) / 2.0 for low, high in each])
        along = float(np.linalg.norm(wide * offset / max(size, 1e-300)))
        return [(max(size - along, 0.0), size + along), *each]

    names, values = ("offset", "offset_x", "offset_y", "offset_z"), (size, *map(float, offset))
    return {
        name: EstimatedValue(value, "mm", (float(a), float(b)), (float(c), float(e)))
        for name, value, (a, b), (c, e) in zip(names, values, ends("ci90"), ends("ci95"), strict=True)
    }
