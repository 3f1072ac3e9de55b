"""Writes the toolpath of the cell with three tools and two setups. Run ``python toolpaths/make_setup_toolpaths.py``.

Deterministic; the output is committed. Both plates are 240 × 160 × 40 mm, the middle of their top is the zero of their
work offset (``cells/make_setup_cells.py``).
"""

from __future__ import annotations

from pathlib import Path

HERE = Path(__file__).resolve().parent
HALF_X, HALF_Y = 120.0, 80.0
HOLES = [(x, y) for y in (-65.0, 65.0) for x in (-105.0, -35.0, 35.0, 105.0)]


def tool(number: int, what: str, offset: str, speed: int) -> list[str]:
    return [f"(OPERATION {what})", f"T{number} M6", offset, f"S{speed} M3", "M8"]


def facing() -> list[str]:
    """Four passes of the face mill, there and back, from beside the plate."""
    x = HALF_X + 35.0
    lines = [f"G0 X{-x:.1f} Y-60.0 Z30.0", "G0 Z5.0", "G1 Z-0.5 F2000", f"G1 X{x:.1f} F1800"]
    for k, y in enumerate((-20.0, 20.0, 60.0)):
        side = -1.0 if k % 2 == 0 else 1.0
        lines += [f"G1 Y{y:.1f} F2000", f"G1 X{side * x:.1f} F1800"]
    return [*lines, "G0 Z60.0", "M5", "M9"]


def ring(depths: tuple[float, ...]) -> list[str]:
    """A slot round a rectangle with rounded corners, ramped down along its first side."""
    x, y, r = 70.0, 40.0, 15.0
    lines = [f"G0 X{-x + r:.1f} Y{-y:.1f} Z30.0", "G0 Z2.0", "G1 Z0.0 F300"]
    for depth in depths:
        lines += [
            f"G1 X{x - r:.1f} Z{-depth:.1f} F600",
            f"G3 X{x:.1f} Y{-y + r:.1f} I0.0 J{r:.1f}",
            f"G1 Y{y - r:.1f}",
            f"G3 X{x - r:.1f} Y{y:.1f} I{-r:.1f} J0.0",
            f"G1 X{-x + r:.1f}",
            f"G3 X{-x:.1f} Y{y - r:.1f} I0.0 J{-r:.1f}",
            f"G1 Y{-y + r:.1f}",
            f"G3 X{-x + r:.1f} Y{-y:.1f} I{r:.1f} J0.0",
        ]
    return [*lines, f"G1 X{x - r:.1f} F600", "G0 Z60.0", "M5", "M9"]


def drilling() -> list[str]:
    x, y = HOLES[0]
    lines = [f"G0 X{x:.1f} Y{y:.1f} Z30.0", f"G99 G81 X{x:.1f} Y{y:.1f} Z-20.0 R3.0 F250"]
    return [*lines, *(f"X{x:.1f} Y{y:.1f}" for x, y in HOLES[1:]), "G80", "G0 Z60.0", "M5", "M9"]


def write_plates() -> None:
    lines = [
        "%",
        "O2410 (TWO PLATES, THREE TOOLS, TWO SETUPS)",
        "(MADE BY TOOLPATHS/MAKE_SETUP_TOOLPATHS.PY; CELL KR240_SETUPS)",
        "G21 G17 G40 G49 G80 G90 G94",
        *tool(1, "FACE THE LYING PLATE", "G54", 3000),
        *facing(),
        *tool(2, "SLOT IN THE LYING PLATE", "G54", 6000),
        *ring((2.0, 4.0)),
        *tool(3, "HOLES IN THE LYING PLATE", "G54", 2500),
        *drilling(),
        "(OPERATION HOLES IN THE UPRIGHT PLATE)",
        "G55",
        "S2500 M3",
        "M8",
        *drilling(),
        *tool(2, "SLOT IN THE UPRIGHT PLATE", "G55", 6000),
        *ring((3.0,)),
        "M30",
        "%",
    ]
    (HERE / "two_plates.nc").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write_plates()
