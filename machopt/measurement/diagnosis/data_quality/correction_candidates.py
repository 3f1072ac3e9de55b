"""Candidate corrections of a part of a recording: units, axes, signs, and rows shifted by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import COLUMNS, FORCES, LENGTHS, MOMENTS, UNITS
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
HEADS = {"displacement": "dx_mm", "position": "x_mm"}


@dataclass(frozen=True, kw_only=True)
class CorrectionCandidate:
    """One alternative reading of a part of a recording."""

    effect: str  # name of the effect UNITS or COLUMNS
    column: str  # first column of the group
    words: str  # the assumed fault in words
    apply: Callable[[Recording], Recording]
    factor: float = 1.0  # applied to the columns
    alternative: tuple[CorrectionCandidate, ...] = ()  # further candidates of other columns, included in ``apply``
    scale: float = 1.0  # factor on the misfit after correction: reading metres as millimetres would shrink any misfit


def generate_correction_candidates(part: Recording) -> Iterator[CorrectionCandidate]:
    """Generate all candidate corrections of a part.

    Args:
        part: Readings of one session or one pose.

    Returns:
        Iterator over the candidates.
    """
    kind = "displacement" if part.kind == "deflection" else "position"
    head = HEADS[kind]
    lengths = list(_generate_length_units(kind, head))
    yield from lengths
    for M, words in _list_axis_permutations():
        yield CorrectionCandidate(
            effect=COLUMNS.name,
            column=head,
            words=f"{head} … hold {words}",
            apply=partial(_transform_measured_values, kind=kind, M=M),
        )
    for by in (-1, 1):
        yield CorrectionCandidate(
            effect=COLUMNS.name,
            column=head,
            words=f"the rows of {head} … stand one too {'low' if by < 0 else 'high'}",
            apply=lambda r, by=by: shift_rows(r, kind, by),  # type: ignore[misc]
        )
    for j in range(part.q.shape[1]):
        yield CorrectionCandidate(
            effect=COLUMNS.name,
            column=f"q{j + 1}_deg",
            words=f"q{j + 1}_deg has the other sign",
            apply=lambda r, j=j: _reverse_joint(r, j),  # type: ignore[misc]
        )
    if part.kind == "deflection" and part.wrench is not None:
        loads = list(_generate_load_corrections(bool(part.wrench[:, 3:].any())))
        yield from loads
        for a, b in product(lengths, (w for w in loads if w.effect == UNITS.name)):
            yield replace(a, apply=lambda r, a=a, b=b: b.apply(a.apply(r)), alternative=(b,))  # type: ignore[misc]
        if part.wrench[:, 3:].any():
            yield from generate_moment_units()


def generate_moment_units() -> Iterator[CorrectionCandidate]:
    """Moments alone in another unit: forces by the sensor, moments by hand from a lever."""
    for name, f in MOMENTS.items():
        yield CorrectionCandidate(
            effect=UNITS.name,
            column="mx_Nm",
            words=f"the columns mx_Nm … hold {name}",
            apply=lambda r, f=f: _scale_moments(r, f),  # type: ignore[misc]
            factor=f,
        )


def _generate_length_units(kind: str, head: str) -> Iterator[CorrectionCandidate]:
    for name, f in LENGTHS.items():
        yield CorrectionCandidate(
            effect=UNITS.name,
            column=head,
            words=f"the columns {head} … hold {name}",
            apply=partial(_transform_measured_values, kind=kind, M=f * np.eye(3)),
            factor=f,
            scale=max(1.0, 1.0 / f),
        )


def _generate_load_corrections(moments: bool) -> Iterator[CorrectionCandidate]:
    for together in (False, True) if moments else (False,):
        beside = " and mx_Nm …" if together else ""
        for name, f in FORCES.items():
            yield CorrectionCandidate(
                effect=UNITS.name,
                column="fx_N",
                words=f"the columns fx_N …{beside} hold {name}",
                apply=lambda r, f=f, t=together: _transform_loads(r, f * np.eye(3), t),  # type: ignore[misc]
                factor=f,
            )
        for M, words in _list_axis_permutations():
            yield CorrectionCandidate(
                effect=COLUMNS.name,
                column="fx_N",
                words=f"fx_N …{beside} hold {words}",
                apply=lambda r, M=M, t=together: _transform_loads(r, M, t),  # type: ignore[misc]
            )


def _list_axis_permutations() -> Iterator[tuple[Array, str]]:
    """Yield signed permutations except the identity, fewest changes first, with the assumed content of columns x, y,
    z.
    """
    found = []
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            M = np.zeros((3, 3))  # correct = M recorded
            for written, axis in enumerate(order):
                M[axis, written] = sign[written]
            changes = sum(o != k for k, o in enumerate(order)) + sum(s < 0 for s in sign)
            words = ", ".join(("−" if s < 0 else "") + "xyz"[o] for o, s in zip(order, sign, strict=True))
            if changes:
                found.append((changes, M, words))
    for _, M, words in sorted(found, key=lambda f: f[0]):
        yield M, words


def select_rows(recording: Recording, rows: Flags) -> Recording:
    """Return the readings of selected rows.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        rows: (N,) True for selected rows.

    Returns:
        Recording with the selected rows.
    """
    changed: dict[str, Any] = {}
    for f in fields(recording):
        value = getattr(recording, f.name)
        if isinstance(value, np.ndarray) and f.name != "wrench_point":
            changed[f.name] = value[rows]
    return replace(recording, **changed)


def replace_rows(recording: Recording, part: Recording, rows: Flags) -> Recording:
    """Replace selected rows of a recording.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        part: Recording that contains the new values of these rows.
        rows: (N,) True for the rows to replace.

    Returns:
        Recording with the replaced rows.
    """
    changed: dict[str, Any] = {}
    for name in ("q", "wrench", "displacement", "position", "quaternion"):
        old = getattr(recording, name)
        if old is not None:
            new = old.copy()
            new[rows] = getattr(part, name)
            changed[name] = new
    return replace(recording, **changed)


def _transform_measured_values(r: Recording, kind: str, M: Array) -> Recording:
    values = getattr(r, kind).copy()
    values[:, :3] = values[:, :3] @ M.T
    changes: dict[str, Any] = {kind: values}
    return replace(r, **changes)


def shift_rows(r: Recording, kind: str, by: int) -> Recording:
    """Shift the measured values of one kind by a number of rows, cyclically.

    Args:
        r: Recording.
        kind: Field to shift, ``displacement`` or ``position``.
        by: Number of rows, positive towards the end.

    Returns:
        Recording with shifted values.
    """
    changes: dict[str, Any] = {kind: np.roll(getattr(r, kind), by, axis=0)}
    if kind == "position" and r.quaternion is not None:
        changes["quaternion"] = np.roll(r.quaternion, by, axis=0)
    return replace(r, **changes)


def _reverse_joint(r: Recording, joint: int) -> Recording:
    q = r.q.copy()
    q[:, joint] *= -1.0
    return replace(r, q=q)


def _scale_moments(r: Recording, factor: float) -> Recording:
    assert r.wrench is not None  # ensured by generate_correction_candidates
    w = r.wrench.copy()
    w[:, 3:] *= factor
    return replace(r, wrench=w)


def _transform_loads(r: Recording, M: Array, together: bool) -> Recording:
    assert r.wrench is not None  # ensured by generate_correction_candidates
    w = r.wrench.copy()
    w[:, :3] = w[:, :3] @ M.T
    if together:
        w[:, 3:] = w[:, 3:] @ M.T
    return replace(r, wrench=w)
