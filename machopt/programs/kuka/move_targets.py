"""Targets of KRL moves: aggregates and names, and their omitted components."""

from __future__ import annotations

import math
import re

from machopt.numerics.array_types import Array
from machopt.programs.kuka.expression_values import KrlMemory, KrlValueError, evaluate_expression, parse_plain_aggregate
from machopt.programs.reading.rotation_conventions import build_pose_matrix, compute_fixed_xyz_rotation

AXES = tuple(f"A{k}" for k in range(1, 7))
POSE = ("X", "Y", "Z", "A", "B", "C")


class KrlTargets:
    """Reads targets, and remembers the last components for those that leave some out."""

    def __init__(self, memory: KrlMemory) -> None:
        self.memory = memory
        self.pose: dict[str, float] = {}
        self.axes: dict[str, float] = {}

    def mark_target_unknown(self) -> None:
        """The robot is at a place that is not known."""
        self.pose, self.axes = {}, {}

    def read(self, text: str, count: int) -> tuple[list[dict[str, object]], list[str]]:
        """Read the targets of a motion.

        Args:
            text: Text behind the motion word.
            count: Number of targets.

        Returns:
            The targets, and the approximation words behind them.

        Raises:
            KrlValueError: a target cannot be evaluated.
        """
        text = re.split(r"\s+WITH\s", text, maxsplit=1, flags=re.IGNORECASE)[0]
        out: list[dict[str, object]] = []
        rest = text.strip()
        for _ in range(count):
            if rest.startswith("{"):
                end = _find_closing_brace(rest)
                one, rest = rest[: end + 1], rest[end + 1 :].lstrip()
                if (plain := parse_plain_aggregate(one)) is not None:
                    out.append(plain)
                    rest = rest.removeprefix(",").lstrip()
                    continue
            else:
                found = re.match(r"[^\s,]+(?:\s*\[[^\]]*\])?", rest)
                if found is None:
                    raise KrlValueError("a move without a target")
                one, rest = found.group(0), rest[found.end() :].lstrip()
            rest = rest.removeprefix(",").lstrip()
            value = evaluate_expression(one, self.memory)
            if not isinstance(value, dict):
                raise KrlValueError(
                    f"{one[:30]!r} is no target; expected a position such as {{X 1,Y 2,Z 3,A 0,B 90,C 0}}"
                )
            out.append(value)
        if not rest:
            return out, []
        flags = re.findall(r"\bC_\w+", rest, re.IGNORECASE)
        other = re.sub(r"\bC_\w+|\bCA\s+[-+.0-9]+|,|#\w+", " ", rest, flags=re.IGNORECASE).strip()
        if other.startswith(":"):
            raise KrlValueError(
                f"{other[:30]!r}: frames chained by a colon are not evaluated; expand the program first"
            )
        if other:
            raise KrlValueError(f"found {other[:30]!r} behind a target; expected C_DIS, C_VEL, C_PTP or nothing")
        return out, [w.upper() for w in flags]

    def full(self, target: dict[str, object]) -> dict[str, float]:
        """Complete a pose; missing components keep their last values.

        Args:
            target: Components of the target: name → value.

        Returns:
            All six components, mm and degrees.

        Raises:
            KrlValueError: a component has no value yet, or is no number.
        """
        self.pose |= {c: get_numeric_component(target, c) for c in POSE if c in target}
        missing = [c for c in POSE if c not in self.pose]
        if missing:
            raise KrlValueError(f"{missing[0]} is not given here or earlier")
        return dict(self.pose)

    def joints(self, target: dict[str, object]) -> list[float]:
        """Complete an axis target; missing axes keep their last values.

        Args:
            target: Components of the target: name → value.

        Returns:
            All six axes, degrees.

        Raises:
            KrlValueError: an axis has no value yet, or is no number.
        """
        self.axes |= {a: get_numeric_component(target, a) for a in AXES if a in target}
        missing = [a for a in AXES if a not in self.axes]
        if missing:
            raise KrlValueError(f"{missing[0]} is not given here or earlier")
        return [self.axes[a] for a in AXES]


def get_numeric_component(target: dict[str, object], component: str) -> float:
    """Return a numeric component of a target.

    Args:
        target: Components of the target: name → value.
        component: Name of the component.

    Returns:
        The number.

    Raises:
        KrlValueError: the component is no number.
    """
    value = target[component]
    if not isinstance(value, float):
        raise KrlValueError(f"{component} is no number")
    return value


def list_external_values(target: dict[str, object]) -> list[float]:
    """Return the external axes E1 … of a target.

    Args:
        target: Components of the target: name → value.

    Returns:
        Values, degrees or mm.
    """
    most = max((k for k in range(1, 7) if f"E{k}" in target), default=0)
    return [get_numeric_component(target, f"E{k}") if f"E{k}" in target else math.nan for k in range(1, most + 1)]


def build_pose(full: dict[str, float]) -> Array:
    """Build the pose of a complete target.

    Args:
        full: Components X, Y, Z in mm and A, B, C in degrees.

    Returns:
        Pose (4, 4), m.
    """
    rows = compute_fixed_xyz_rotation(full["C"], full["B"], full["A"])
    return build_pose_matrix(rows, full["X"] * 1e-3, full["Y"] * 1e-3, full["Z"] * 1e-3)


def _find_closing_brace(text: str) -> int:
    depth, first = 0, text.find("}")
    if first >= 0 and text.find("{", 1, first) < 0:
        return first
    for k, c in enumerate(text):
        depth += (c == "{") - (c == "}")
        if depth == 0:
            return k
    raise KrlValueError("a brace is not closed")
