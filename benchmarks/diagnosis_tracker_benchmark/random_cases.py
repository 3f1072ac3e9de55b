"""Cases by seed: arm, lab, what is concealed and what would be right to say of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from dh_arms import DESIGNS, Arm, Concealed
from tracker_recording import Habit, seen, write

Names = tuple[tuple[str, str], ...]  # any of these says the same
GROUPS = ("null", "zeros", "one", "several", "fault")
WEIGHT = 3  # kinds of one effect before those that weight shows
FAULTS: dict[str, Names] = {
    "radians last": (("units", "column:q1_deg"),),
    "turns": (("units", "column:q1_deg"),),
    "gon last": (("units", "column:q1_deg"),),
    "metres last": (("units", "column:x_mm"),),
    "inches last": (("units", "column:x_mm"),),
    "mirrored": (("columns", "*"),),
    "x and y last": (("columns", "*"),),
    "sign of 5": (("columns", "*"),),
    "4 for 5": (("columns", "*"),),
    "zero of 3 last": (("joint_zero_offset", "joint:3"), ("columns", "*")),
    "tilt exchanged": (("columns", "*"),),
    "tilt in degrees": (("units", "*"), ("columns", "*")),
    "": (("displacement_frame", "sensor:displacement"), ("columns", "*")),  # the tracker put down again
}


@dataclass(frozen=True)
class Truth:
    """One thing that is so."""

    names: Names
    size: tuple[str, float] | None = None  # parameter of the finding and its true value


@dataclass(frozen=True)
class Case:
    """A recording."""

    name: str
    arm: str
    habit: Habit
    concealed: Concealed = field(default_factory=Concealed)
    truths: tuple[Truth, ...] = ()
    tool_beside: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, where the cell has the tool beside the true one
    seed: int = 0

    def make(self, room: Path) -> None:
        """Cell and recording."""
        rng = np.random.default_rng([self.seed, 1])
        springs = np.exp(0.2 * rng.normal(size=6))
        arm = Arm(self.arm, replace(self.concealed, spring_factor=springs))
        write(room, arm, seen(arm, self.habit, rng), self.habit, arm.tool + np.array(self.tool_beside))


def cases(seed: int, group: str, count: int) -> list[Case]:
    """A draw of a group."""
    out = []
    for k in range(count):
        own = int(np.random.default_rng([seed, GROUPS.index(group), k]).integers(2**31))
        made = _MAKERS[group](np.random.default_rng(own), k)
        out.append(replace(made, name=f"{group}{k:02d}", seed=own))
    return out


def _lab(rng: np.random.Generator, **more: object) -> Habit:
    """A lab of some habits; ``more`` is certain."""
    return replace(
        Habit(
            poses=int(rng.integers(30, 70)),
            sessions=int(rng.integers(1, 3)) if rng.random() < 0.3 else 2,
            fit=bool(rng.random() < 0.7),
            six=bool(rng.random() < 0.2),
            stated=bool(rng.random() < 0.8),
        ),
        **more,  # type: ignore[arg-type]
    )


def _arm(rng: np.random.Generator) -> str:
    return str(rng.choice(list(DESIGNS)))


def _null(rng: np.random.Generator, k: int) -> Case:
    habit = _lab(rng)
    if k % 4 == 1:
        habit = replace(habit, poses=int(rng.integers(12, 25)), reflectors=3 if rng.random() < 0.5 else 0)
    if k % 4 == 2:
        habit = replace(habit, tilt=int(rng.integers(1, 4)), fit=True)
    if k % 4 == 3:
        habit = replace(habit, hall=habit.fit, noise_mm=(0.02, 0.02, 0.04))
    return Case("", _arm(rng), habit)


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _zero(rng: np.random.Generator, joint: int) -> tuple[Concealed, Truth]:
    angle = _sign(rng) * rng.uniform(0.5e-3, 1.2e-3)
    where = f"joint:{joint}"
    return Concealed(zero=np.eye(6)[joint - 1] * angle), Truth(
        (("joint_zero_offset", where),), ("offset", float(np.degrees(angle)))
    )


def _wave(rng: np.random.Generator, joint: int) -> tuple[Concealed, Truth]:
    order, size = int(rng.integers(2, 6)) if joint > 2 else int(rng.integers(3, 9)), rng.uniform(2e-4, 4e-4)
    return Concealed(waves=((joint - 1, float(order), size, rng.uniform(0, 6.28)),)), Truth(
        (("transmission_error", f"joint:{joint}"),), ("amplitude", float(np.degrees(size) * 3600))
    )


def _frame(rng: np.random.Generator, joint: int) -> tuple[Concealed, Truth]:
    twist = rng.normal(0, [5e-4, 5e-4, 5e-4, 5e-4])
    after = (("geometry", f"joint:{joint}"), ("geometry", f"joint:{joint + 1}"))
    return Concealed(built={joint - 1: twist}), Truth(after)


def _payload(rng: np.random.Generator, arm: str) -> tuple[Concealed, Truth]:
    mass = float(rng.uniform(0.5, 0.8) * DESIGNS[arm].tool_mass)
    return Concealed(payload=mass), Truth((("payload", "tool"),), ("mass", mass))


def _base(rng: np.random.Generator, arm: str) -> tuple[Concealed, Truth]:
    return Concealed(base=float(rng.uniform(3e-8, 5e-8) * 3e6 / DESIGNS[arm].spring[0])), Truth(
        (("base_compliance", "base"),)
    )


def _zeros(rng: np.random.Generator, k: int) -> Case:
    """Zero offsets of two to four joints: what frames hold among their directions."""
    joints = rng.choice([2, 3, 4, 5], int(rng.integers(2, 5)), replace=False)
    each = [_zero(rng, int(j)) for j in sorted(joints)]
    return Case("", _arm(rng), _lab(rng), _joined([c for c, _ in each]), tuple(t for _, t in each))


def _one(rng: np.random.Generator, k: int) -> Case:
    """One effect; what weight shows, on the heavy arm."""
    kind, arm = k % 5, _arm(rng) if k % 5 < WEIGHT else "big"
    if kind == 0:
        concealed, truth = _zero(rng, int(rng.integers(2, 6)))
    elif kind == 1:
        concealed, truth = _wave(rng, int(rng.choice([1, 2, 4])))
    elif kind == 2:
        concealed, truth = _frame(rng, int(rng.integers(2, 5)))
    else:
        concealed, truth = (_payload, _base)[kind - WEIGHT](rng, arm)
    return Case("", arm, _lab(rng, poses=60), concealed, (truth,))


def _several(rng: np.random.Generator, k: int) -> Case:
    """Two or three of zero offsets, waves, a frame, a payload."""
    parts = [_zero(rng, int(rng.integers(2, 4))), _wave(rng, int(rng.choice([1, 4])))]
    if k % 3 == 1:
        parts.append(_frame(rng, 4))
    if k % 3 == 2:
        parts[1] = _payload(rng, "big")
    arm = "big" if k % 3 == 2 else _arm(rng)
    return Case("", arm, _lab(rng, poses=60), _joined([c for c, _ in parts]), tuple(t for _, t in parts))


def _fault(rng: np.random.Generator, k: int) -> Case:
    kind = list(FAULTS)[k % len(FAULTS)]
    tilted = kind.startswith("tilt")
    habit = _lab(rng, sessions=2, fault=kind, moved_mm=0.0 if kind else 0.4, tilt=1 if tilted else None)
    concealed, more = _base(rng, "big") if tilted else (Concealed(), None)
    truths = (Truth(FAULTS[kind]), *(() if more is None else (more,)))
    arm = "cobot" if kind == "mirrored" else "big" if tilted else "mid"
    return Case("", arm, habit, concealed, truths)


def _joined(parts: list[Concealed]) -> Concealed:
    return Concealed(
        zero=np.sum([c.zero for c in parts], axis=0),
        waves=tuple(w for c in parts for w in c.waves),
        built={i: v for c in parts for i, v in c.built.items()},
        payload=sum(c.payload for c in parts),
    )


_MAKERS: dict[str, Callable[[np.random.Generator, int], Case]] = {
    "null": _null,
    "zeros": _zeros,
    "one": _one,
    "several": _several,
    "fault": _fault,
}
