"""Run `rs274` and read the canonical commands it prints, as moves in the coordinate system of the first move."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
COMMAND = shutil.which("rs274")
_LINE = re.compile(r"\s*\d+\s+N\S*\s+([A-Z0-9_]+)\((.*)\)\s*$")
_PLANES = {"CANON_PLANE_XY": (0, 1, 2), "CANON_PLANE_XZ": (2, 0, 1), "CANON_PLANE_YZ": (1, 2, 0)}
_TIMEOUT_S = 20.0


@dataclass(frozen=True)
class Element:
    """One move: straight, or an arc about ``centre`` that sweeps ``sweep`` rad about axis ``normal``."""

    rapid: bool
    end: Array  # (3,) mm
    centre: Array | None = None
    normal: int = 2
    turns: int = 0  # as printed: sign is the sense, size the turns begun


@dataclass(frozen=True)
class Canon:
    """What the interpreter made of a program."""

    elements: list[Element]
    refused: str  # its message, empty where it came to the end


def interpret(text: str) -> Canon:
    """Run the interpreter with a fresh parameter file of its own."""
    if COMMAND is None:
        raise RuntimeError("rs274 is not installed")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "program.ngc")
        file.write_text(text, encoding="latin-1")
        Path(folder, "fresh.var").write_text("", encoding="ascii")
        words = [COMMAND, "-v", str(Path(folder, "fresh.var")), "-g", str(file)]
        try:
            done = subprocess.run(words, cwd=folder, capture_output=True, timeout=_TIMEOUT_S, check=False)
        except subprocess.TimeoutExpired:
            return Canon([], "no end within the time")
    out, err = done.stdout.decode("latin-1"), done.stderr.decode("latin-1")
    said = [t for t in err.splitlines() if t.strip() and t.strip() != "executing"]
    return Canon(_elements(out), said[0] if said else "")


class _State:
    """Units, plane and coordinate systems while the commands are read."""

    def __init__(self) -> None:
        self.unit, self.plane, self.angle = 1.0, (0, 1, 2), 0.0
        self.g5x, self.g92 = np.zeros(3), np.zeros(3)
        self.first: tuple[Array, float] | None = None

    def place(self, p: Array) -> Array:
        """Programmed mm in the work offset of the first move: R₀ᵀ(g5x + R(p + g92) − g5x₀)."""
        if self.first is None:
            self.first = self.g5x.copy(), self.angle
        machine = self.g5x + _rotation(self.angle) @ (p + self.g92)
        return np.asarray(_rotation(self.first[1]).T @ (machine - self.first[0]))


def _rotation(degrees: float) -> Array:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _elements(out: str) -> list[Element]:
    state, found = _State(), []
    for line in out.splitlines():
        read = _LINE.match(line)
        if read is None:
            continue
        name, text = read.groups()
        if name == "USE_LENGTH_UNITS":
            state.unit = 25.4 if "INCH" in text else 1.0
        elif name == "SELECT_PLANE":
            state.plane = _PLANES[text]
        elif name == "SET_XY_ROTATION":
            state.angle = float(text)
        elif name in ("SET_G5X_OFFSET", "SET_G92_OFFSET"):
            v = np.array([float(t) for t in text.split(",")][int(name == "SET_G5X_OFFSET") :][:3]) * state.unit
            state.g5x, state.g92 = (v, state.g92) if name == "SET_G5X_OFFSET" else (state.g5x, v)
        elif name in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED"):
            p = np.array([float(t) for t in text.split(",")][:3]) * state.unit
            found.append(Element(name == "STRAIGHT_TRAVERSE", state.place(p)))
        elif name == "RIGID_TAP":  # there and back
            start = found[-1].end if found else np.zeros(3)
            p = np.array([float(t) for t in text.split(",")][:3]) * state.unit
            found += [Element(False, state.place(p)), Element(False, start)]
        elif name == "ARC_FEED":
            found.append(_arc(text, state))
    return found


def _arc(text: str, state: _State) -> Element:
    v = [float(t) for t in text.split(",")]
    first, second, normal = state.plane
    end, centre = np.zeros(3), np.zeros(3)
    end[first], end[second], end[normal] = (x * state.unit for x in (v[0], v[1], v[5]))
    centre[first], centre[second] = v[2] * state.unit, v[3] * state.unit
    return Element(False, state.place(end), state.place(centre), normal, round(v[4]))
