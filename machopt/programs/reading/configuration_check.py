"""Status, turns and confdata recomputed from the joints, to check the values in a program.

An axis that lies on a boundary as printed may count to either side. ``posts/README.md`` gives the meanings.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

SLACK = 2e-4  # deg: axes are printed to 1e-4 at least
PostureWords = tuple[NDArray[np.bool_], NDArray[np.bool_]]


def find_first_difference(
    dialect: str,
    configuration: tuple[Mapping[str, object], ...],
    axes_deg: Array,
    posture: PostureWords | None,
    nonflip_j5: Literal["negative", "positive"] | None = None,
) -> tuple[int, int | None]:
    """Count the moves with values that can be recomputed, and find the first wrong one.

    Args:
        dialect: of the parsed program.
        configuration: of its moves.
        axes_deg: (M, 6) as the controller counts them.
        posture: wrist root behind axis 1 (M,), elbow up (M,); None where the arm has no such.
        nonflip_j5: FANUC's N.
    """
    told, wrong = 0, None
    for k, said in enumerate(configuration):
        standing = None if posture is None else (bool(posture[0][k]), bool(posture[1][k]))
        verdicts = _compare_words(dialect, said, axes_deg[k].tolist(), standing, nonflip_j5)
        told += bool(verdicts)
        if wrong is None and not all(verdicts):
            wrong = k
    return told, wrong


def _compare_words(
    dialect: str, said: Mapping[str, object], a: list[float], standing: tuple[bool, bool] | None, nonflip: str | None
) -> list[bool]:
    """One for each word that is known here."""
    low, high = [v - SLACK for v in a], [v + SLACK for v in a]
    below = [{low[k] < 0.0, high[k] < 0.0} for k in range(6)]  # accepted values of each axis
    out: list[bool] = []
    if dialect == "krl":
        if isinstance(said.get("T"), int):
            out += [bool(int(said["T"]) >> k & 1) in below[k] for k in range(6)]  # type: ignore[call-overload]
        if isinstance(said.get("S"), int) and standing is not None:
            s = int(said["S"])  # type: ignore[call-overload]
            out += [bool(s & 1) == standing[0], bool(s & 2) == standing[1], bool(s & 4) in below[4]]
    elif dialect == "rapid" and "cf1" in said:
        for name, k in (("cf1", 0), ("cf4", 3), ("cf6", 5)):
            out.append(said[name] in {low[k] // 90.0, high[k] // 90.0})
        if standing is not None:
            cfx = int(said["cfx"])  # type: ignore[call-overload]
            out += [bool(cfx & 4) == standing[0], bool(cfx & 2) != standing[1], bool(cfx & 1) in below[4]]
    elif dialect == "fanuc" and "config" in said:
        flip, elbow, front = tuple(str(said["config"]).ljust(3)[:3])
        if standing is not None:
            out += [elbow == "DU"[standing[1]], front == "TB"[standing[0]]]
        if nonflip is not None:
            out.append(any((flip == "N") == (b == (nonflip == "negative")) for b in below[4]))
        turns: tuple[int, ...] = tuple(said["turns"])  # type: ignore[arg-type]
        for turn, k in zip(turns, (0, 3, 5), strict=True):
            out.append(-180.0 - SLACK <= a[k] - 360.0 * turn <= 180.0 + SLACK)
    elif dialect == "val3" and "wrist" in said:
        out.append((said["wrist"] == "wnegative") in below[4])
        out.append((said.get("elbow") == "enegative") in below[2])
        if standing is not None:
            out.append(said.get("shoulder") == ("righty" if standing[0] else "lefty"))
    elif dialect == "jbi" and "rconf" in said:
        bits: tuple[int, ...] = tuple(said["rconf"])  # type: ignore[arg-type]
        out.append(bool(bits[0]) in below[4])
        if standing is not None:
            out += [bool(bits[1]) != standing[1], bool(bits[2]) == standing[0]]
        for bit, k in zip(bits[3:], (3, 5, 0), strict=True):
            far = {abs(low[k]) >= 180.0, abs(high[k]) >= 180.0, abs(a[k]) >= 180.0}
            out.append(bool(bit) in far)
    return out
