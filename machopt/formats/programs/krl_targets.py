"""Targets of KRL moves: aggregates and names, and the components that they leave out."""

from __future__ import annotations

import math
import re

from machopt.arrays import Array
from machopt.formats.programs.krl_values import KrlError, Memory, evaluate, plain_aggregate
from machopt.formats.programs.rotations import fixed_xyz, matrix

AXES = tuple(f"A{k}" for k in range(1, 7))
POSE = ("X", "Y", "Z", "A", "B", "C")


class Targets:
    """Reads targets, and remembers the last components for those that leave some out."""

    def __init__(self, memory: Memory) -> None:
        self.memory = memory
        self.pose: dict[str, float] = {}
        self.axes: dict[str, float] = {}

    def forget(self) -> None:
        """The robot is at a place that is not known."""
        self.pose, self.axes = {}, {}

    def read(self, text: str, count: int) -> tuple[list[dict[str, object]], list[str]]:
        """The targets of a motion, and the approximation words after them."""
        text = re.split(r"\s+WITH\s", text, maxsplit=1, flags=re.IGNORECASE)[0]
        out: list[dict[str, object]] = []
        rest = text.strip()
        for _ in range(count):
            if rest.startswith("{"):
                end = _closing(rest)
                one, rest = rest[: end + 1], rest[end + 1 :].lstrip()
                if (plain := plain_aggregate(one)) is not None:
                    out.append(plain)
                    rest = rest.removeprefix(",").lstrip()
                    continue
            else:
                found = re.match(r"[^\s,]+(?:\s*\[[^\]]*\])?", rest)
                if found is None:
                    raise KrlError("a move without a target")
                one, rest = found.group(0), rest[found.end() :].lstrip()
            rest = rest.removeprefix(",").lstrip()
            value = evaluate(one, self.memory)
            if not isinstance(value, dict):
                raise KrlError(f"{one[:30]!r} is no target; expected a position such as {{X 1,Y 2,Z 3,A 0,B 90,C 0}}")
            out.append(value)
        if not rest:
            return out, []
        flags = re.findall(r"\bC_\w+", rest, re.IGNORECASE)
        other = re.sub(r"\bC_\w+|\bCA\s+[-+.\d]+|,|#\w+", " ", rest, flags=re.IGNORECASE).strip()
        if other.startswith(":"):
            raise KrlError(f"{other[:30]!r}: frames chained by a colon are not evaluated; expand the program first")
        if other:
            raise KrlError(f"found {other[:30]!r} behind a target; expected C_DIS, C_VEL, C_PTP or nothing")
        return out, [w.upper() for w in flags]

    def full(self, target: dict[str, object]) -> dict[str, float]:
        """All six components; those left out are the last ones."""
        self.pose |= {c: numeric(target, c) for c in POSE if c in target}
        missing = [c for c in POSE if c not in self.pose]
        if missing:
            raise KrlError(f"{missing[0]} is not given and stands nowhere before")
        return dict(self.pose)

    def joints(self, target: dict[str, object]) -> list[float]:
        """All six axes (deg); those left out are the last ones."""
        self.axes |= {a: numeric(target, a) for a in AXES if a in target}
        missing = [a for a in AXES if a not in self.axes]
        if missing:
            raise KrlError(f"{missing[0]} is not given and stands nowhere before")
        return [self.axes[a] for a in AXES]


def numeric(target: dict[str, object], component: str) -> float:
    value = target[component]
    if not isinstance(value, float):
        raise KrlError(f"{component} is no number")
    return value


def externals(target: dict[str, object]) -> list[float]:
    most = max((k for k in range(1, 7) if f"E{k}" in target), default=0)
    return [numeric(target, f"E{k}") if f"E{k}" in target else math.nan for k in range(1, most + 1)]


def placed(full: dict[str, float]) -> Array:
    rows = fixed_xyz(full["C"], full["B"], full["A"])
    return matrix(rows, full["X"] * 1e-3, full["Y"] * 1e-3, full["Z"] * 1e-3)


def _closing(text: str) -> int:
    depth, first = 0, text.find("}")
    if first >= 0 and text.find("{", 1, first) < 0:
        return first
    for k, c in enumerate(text):
        depth += (c == "{") - (c == "}")
        if depth == 0:
            return k
    raise KrlError("a brace is not closed")
