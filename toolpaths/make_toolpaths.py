"""Writes the example toolpaths for the cells of ``cells/``. Run ``python toolpaths/make_toolpaths.py``.

Deterministic; the output is committed. Coordinates in mm in the CAM frame of the cell named in README.md; tool
axes point from tip to shank. The workpiece surfaces are those of cells/making/: the cylinder head's deck
is z = 0 with a 28 mm wide rim, the panel is a cylinder of radius 1500 mm about a line parallel to y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).resolve().parent
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Row:
    tip: Vector
    axis: Vector
    move: str  # cut | rapid | approach | retract | link
    feed: float | None
    operation: str


@dataclass
class Table:
    """Rows of the contract's toolpath CSV."""

    rows: list[Row] = field(default_factory=list)

    def add(self, tip: Vector, axis: Vector, move: str, feed: float | None, operation: str) -> None:
        self.rows.append(Row(tip, axis, move, feed, operation))

    def write(self, name: str, head: str) -> None:
        lines = [f"# {head}", "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation"]
        for r in self.rows:
            feed = "" if r.feed is None else f"{r.feed:g}"
            numbers = ",".join([*(fixed(v, 4) for v in r.tip), *(fixed(v, 7) for v in r.axis)])
            lines.append(f"{numbers},{r.move},{feed},{r.operation}")
        write(name, lines)


def write(name: str, lines: list[str]) -> None:
    (HERE / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def fixed(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def along(tip: Vector, axis: Vector, distance: float) -> Vector:
    return tuple(t + distance * a for t, a in zip(tip, axis, strict=True))  # type: ignore[return-value]


# --- kr240_drilling: holes of the panel --------------------------------------------------------------------

PANEL_RADIUS = 1500.0
ROW_PITCH, HOLE_PITCH, ROWS, HOLES = 60.0, 80.0, 10, 12
DRILL_FEED, RETRACT_FEED = 420.0, 3000.0  # mm/min; out of the hole under feed, a rapid move must not touch the part
BREAK_THROUGH, OUT, CLEARANCE = 7.0, 2.0, 20.0  # mm: tip below the outer face (skin is 4 mm), out of the hole, above it


def panel_holes() -> list[tuple[int, Vector, Vector]]:
    """Row number, hole centre on the outer face and outward normal, in drilling order (serpentine)."""
    holes = []
    for r in range(ROWS):
        angle = (r - (ROWS - 1) / 2) * ROW_PITCH / PANEL_RADIUS
        axis = (math.sin(angle), 0.0, math.cos(angle))
        order = range(HOLES) if r % 2 == 0 else range(HOLES - 1, -1, -1)
        for h in order:
            y = (h - (HOLES - 1) / 2) * HOLE_PITCH
            holes.append((r + 1, (PANEL_RADIUS * axis[0], y, PANEL_RADIUS * (axis[2] - 1.0)), axis))
    return holes


def write_panel() -> None:
    table = Table()
    apt = [
        "$$ -----------------------------------------------------------------",
        "$$     Generated for machopt by toolpaths/make_toolpaths.py",
        "$$     CATIA APT VERSION 1.0",
        "$$ -----------------------------------------------------------------",
        "$$ Manufacturing Program.1",
        "$$  Part Operation.1",
        "$$*CATIA0",
        "$$ Manufacturing Program.1",
        "$$     1.00000     0.00000     0.00000     0.00000",
        "$$     0.00000     1.00000     0.00000     0.00000",
        "$$     0.00000     0.00000     1.00000     0.00000",
        "PARTNO PANEL R1500",
        "$$ OPERATION NAME : Tool Change.1",
        "$$  Start generation of : Tool Change.1",
        "MULTAX",
        "$$ TOOLCHANGEBEGINNING",
        "CUTTER/  6.000000,  0.000000,  3.000000,  0.000000,  0.000000,$",
        "  0.000000, 70.000000",
        "TOOLNO/1,DRILL,   6.000000,   0.000000,  70.000000",
        "TPRINT/T1 Twist Drill D 6",
        "LOADTL/1",
        "$$ TOOLCHANGEEND",
        "$$  End of generation of : Tool Change.1",
    ]

    def goto(tip: Vector, axis: Vector) -> str:
        return (
            "GOTO  /"
            + ",".join(f"{fixed(v, 5):>12}" for v in tip)
            + ",$\n"
            + ",".join(f"{fixed(v, 6):>10}" for v in axis)
        )

    row = 0
    for r, hole, axis in panel_holes():
        name = f"Drilling row {r}"
        if r != row:
            if row:
                apt.append(f"$$  End of generation of : Drilling row {row}")
            apt += [f"$$ OPERATION NAME : {name}", f"$$  Start generation of : {name}"]
            if not row:
                apt.append("SPINDL/ 4000.0000,RPM,CLW")
            row = r
        over, near, bottom = (along(hole, axis, d) for d in (CLEARANCE, OUT, -BREAK_THROUGH))
        apt += ["RAPID", goto(over, axis), f"FEDRAT/  {DRILL_FEED:.4f},MMPM", goto(bottom, axis)]
        apt += [f"FEDRAT/ {RETRACT_FEED:.4f},MMPM", goto(near, axis), "RAPID", goto(over, axis)]
        table.add(over, axis, "rapid", None, name)
        table.add(bottom, axis, "cut", DRILL_FEED, name)
        table.add(near, axis, "cut", RETRACT_FEED, name)
        table.add(over, axis, "rapid", None, name)
    apt += [f"$$  End of generation of : Drilling row {row}", "SPINDL/OFF", "FINI"]
    write("panel_holes.aptsource", apt)
    table.write("panel_holes.csv", "the holes of panel_holes.aptsource; cell kr240_drilling")


# --- kr500_milling: the head's rim -------------------------------------------------------------------------

RIM_X, RIM_Y, CORNER = 216.0, 81.0, 25.0  # centre line of the 28 mm rim, and its corner radius


def rim(s: float) -> tuple[float, float, float]:
    """x, y and travel direction (rad) at arc length ``s`` counter-clockwise from the middle of the −y side."""
    straight = [RIM_X - CORNER, 2 * (RIM_Y - CORNER), 2 * (RIM_X - CORNER), 2 * (RIM_Y - CORNER), RIM_X - CORNER]
    x, y, heading = 0.0, -RIM_Y, 0.0
    for k, length in enumerate(straight):
        step = min(s, length)
        x, y, s = x + step * math.cos(heading), y + step * math.sin(heading), s - step
        if s <= 0 or k == len(straight) - 1:
            return x, y, heading
        turn = min(s / CORNER, math.pi / 2)
        x += CORNER * (math.sin(heading + turn) - math.sin(heading))
        y -= CORNER * (math.cos(heading + turn) - math.cos(heading))
        heading, s = heading + turn, s - turn * CORNER
        if s <= 0:
            return x, y, heading
    raise AssertionError


RIM_LENGTH = 4 * (RIM_X - CORNER) + 4 * (RIM_Y - CORNER) + 2 * math.pi * CORNER


def tilted(heading: float, lead: float, lean: float) -> Vector:
    """Tool axis leaning by ``lead`` rad forward in travel and ``lean`` rad to the right of it."""
    a, b = math.tan(lead), math.tan(lean)
    x = a * math.cos(heading) + b * math.sin(heading)
    y = a * math.sin(heading) - b * math.cos(heading)
    n = math.sqrt(x * x + y * y + 1.0)
    return x / n, y / n, 1.0 / n


def write_contour(points: int = 2400) -> None:
    """Sealing groove along the rim, cut with a ball-ended cutter whose axis sways within ±20°."""
    table, label = Table(), "sealing groove"
    path = []
    for k in range(points):
        u = k / (points - 1)
        x, y, heading = rim(u * RIM_LENGTH)
        window = math.sin(math.pi * min(1.0, 12 * u, 12 * (1 - u)) / 2) ** 2  # starts and ends upright
        lean = math.radians(14.0) * window * math.sin(2 * math.pi * 3 * u)
        lead = math.radians(13.0) * window * math.cos(2 * math.pi * 2 * u)
        depth = 1.2 - 0.4 * math.cos(2 * math.pi * 4 * u)
        path.append(((x, y, -depth * min(1.0, 60 * u + 0.1, 60 * (1 - u) + 0.1)), tilted(heading, lead, lean)))
    start, end = path[0], path[-1]
    up: Vector = (0.0, 0.0, 1.0)
    table.add((start[0][0], start[0][1], 60.0), up, "rapid", None, label)
    table.add((start[0][0], start[0][1], 5.0), up, "rapid", None, label)
    for k, (tip, axis) in enumerate(path):
        u = k / (points - 1)
        feed = 300.0 if k == 0 else round(1600.0 + 400.0 * math.cos(2 * math.pi * 2 * u), -2)
        table.add(tip, axis, "cut", feed, label)
    table.add((end[0][0], end[0][1], 60.0), up, "rapid", None, label)
    table.write("contour_5axis.csv", "the points of contour_5axis.nc; cell kr500_milling")

    lines = [
        "%",
        "O2400 (SEALING GROOVE, CYLINDER HEAD)",
        "(MADE BY TOOLPATHS/MAKE_TOOLPATHS.PY)",
        "(G43.5: X Y Z IS THE TOOL TIP, I J K THE TOOL AXIS FROM TIP TO SHANK)",
        "G21 G17 G40 G90 G94",
        "T3 M6 (BALL END MILL D8)",
        "G54",
        "S9000 M3",
        "M8",
    ]
    feed: float | None = None
    for n, row in enumerate(table.rows):
        xyz = " ".join(f"{w}{fixed(v, 4)}" for w, v in zip("XYZ", row.tip, strict=True))
        ijk = " ".join(f"{w}{fixed(v, 7)}" for w, v in zip("IJK", row.axis, strict=True))
        word = "G0" if row.move == "rapid" else "G1"
        if n == 0:
            lines.append(f"G43.5 H3 G0 {xyz} {ijk}")
            continue
        tail = "" if row.feed is None or row.feed == feed else f" F{row.feed:g}"
        feed = row.feed if row.feed is not None else feed
        lines.append(f"N{10 * n} {word} {xyz} {ijk}{tail}")
    write("contour_5axis.nc", [*lines, "G49", "M9", "M5", "M30", "%"])


def write_plain() -> None:
    """Two short passes along the long sides of the rim, weaving and leaning a little."""
    table = Table()
    up: Vector = (0.0, 0.0, 1.0)
    for label, side in (("front rim", -1.0), ("rear rim", 1.0)):
        count, first = 96, -side * RIM_X + side * 10.0
        path = []
        for k in range(count):
            u = k / (count - 1)
            x = first * (1 - 2 * u)
            y = side * RIM_Y + 5.0 * math.sin(2 * math.pi * 2 * u)
            heading = math.atan2(5.0 * 4 * math.pi * math.cos(4 * math.pi * u), -2 * first)
            axis = tilted(heading, math.radians(6.0), math.radians(8.0) * math.sin(math.pi * u))
            path.append(((x, y, -0.5 - 0.3 * math.sin(math.pi * u)), axis))
        (tip, axis), (last, last_axis) = path[0], path[-1]
        if not table.rows:
            table.add((tip[0], tip[1], 80.0), up, "rapid", None, label)
        table.add(along(tip, axis, 30.0), axis, "rapid", None, label)
        table.add(along(tip, axis, 3.0), axis, "approach", 1500.0, label)
        table.add(tip, axis, "cut", 400.0, label)
        for point, direction in path[1:]:
            table.add(point, direction, "cut", 1200.0, label)
        table.add(along(last, last_axis, 5.0), last_axis, "retract", 1500.0, label)
        table.add(along(last, last_axis, 50.0), last_axis, "rapid", None, label)
    table.write("plain.csv", "two weaving passes on the rim of the cylinder head; cell kr500_milling")


def write_head_face() -> None:
    """NX CLSF: zig passes over the deck, then once round the rim with corner arcs."""
    out = [
        "TOOL PATH/FACE_DECK,TOOL,MILL_D17_Z2",
        "TLDATA/MILL,17.0000,0.8000,80.0000,0.0000,0.0000",
        "MSYS/0.0000,0.0000,0.0000,1.0000000,0.0000000,0.0000000,0.0000000,1.0000000,0.0000000",
        "$$ centerline data",
        "PAINT/PATH",
        "PAINT/SPEED,10",
        "LOAD/TOOL,1",
        "SPINDL/RPM,1500.0,CLW",
    ]

    def goto(x: float, y: float, z: float, axis: bool = False) -> str:
        return "GOTO/" + ",".join(fixed(v, 4) for v in (x, y, z)) + (",0.0000000,0.0000000,1.0000000" if axis else "")

    over, near, high = 246.0, 5.0, 50.0
    passes = [-88.0 + 11.0 * k for k in range(17)]
    for n, y in enumerate(passes):
        out += [
            "PAINT/COLOR,186",
            "RAPID",
            goto(-over, y, high, axis=n == 0),
            "PAINT/COLOR,211",
            "RAPID",
            goto(-over, y, near),
        ]
        out += [
            "PAINT/COLOR,42",
            "FEDRAT/MMPM,600.0000",
            goto(-over, y, 0.0),
            "PAINT/COLOR,31",
            "FEDRAT/MMPM,1200.0000",
            goto(-over + 4.0, y, 0.0),  # still beside the part
        ]
        out += [goto(over, y, 0.0), "PAINT/COLOR,37", "FEDRAT/MMPM,2000.0000", goto(over, y, near)]
        out += ["PAINT/COLOR,186", "RAPID", goto(over, y, high)]
    out += ["PAINT/SPEED,10", "PAINT/TOOL,NOMORE", "END-OF-PATH"]

    # counter-clockwise once round; NX states the axis about which travel is clockwise, hence (0, 0, -1)
    lead, z = 15.0, -0.3
    out += [
        "TOOL PATH/RIM_FINISH,TOOL,MILL_D17_Z2",
        "TLDATA/MILL,17.0000,0.8000,80.0000,0.0000,0.0000",
        "MSYS/0.0000,0.0000,0.0000,1.0000000,0.0000000,0.0000000,0.0000000,1.0000000,0.0000000",
        "$$ centerline data",
        "PAINT/PATH",
        "PAINT/COLOR,186",
        "RAPID",
        goto(-lead, -RIM_Y + lead, high, axis=True),
        "PAINT/COLOR,211",
        "RAPID",
        goto(-lead, -RIM_Y + lead, near),
        "PAINT/COLOR,42",
        "FEDRAT/MMPM,600.0000",
        goto(-lead, -RIM_Y + lead, z),
    ]

    def circle(cx: float, cy: float, radius: float) -> str:
        centre = ",".join(fixed(v, 4) for v in (cx, cy, z))
        return f"CIRCLE/{centre},0.0000000,0.0000000,-1.0000000,{radius:.4f},0.0300,0.5000,17.0000,0.8000"

    a, b, c = RIM_X, RIM_Y, CORNER
    out += [circle(0.0, -b + lead, lead), goto(0.0, -b, z), "PAINT/COLOR,31", "FEDRAT/MMPM,900.0000"]
    corners = [
        ((a - c, -b), (a - c, -b + c), (a, -b + c)),
        ((a, b - c), (a - c, b - c), (a - c, b)),
        ((-a + c, b), (-a + c, b - c), (-a, b - c)),
        ((-a, -b + c), (-a + c, -b + c), (-a + c, -b)),
    ]
    for start, centre, end in corners:
        out += [goto(*start, z), circle(*centre, c), goto(*end, z)]
    out += [goto(0.0, -b, z), "PAINT/COLOR,37", "FEDRAT/MMPM,2000.0000", circle(0.0, -b + lead, lead)]
    out += [
        goto(lead, -b + lead, z),
        goto(lead, -b + lead, near),
        "PAINT/COLOR,186",
        "RAPID",
        goto(lead, -b + lead, high),
    ]
    out += ["PAINT/SPEED,10", "PAINT/TOOL,NOMORE", "END-OF-PATH"]
    write("cylinder_head_face.cls", out)


# --- the other cells ---------------------------------------------------------------------------------------


def write_plate() -> None:
    """irb6700_drilling: twenty holes through a 30 mm plate in three pecks."""
    table = Table()
    up: Vector = (0.0, 0.0, 1.0)
    for k in range(20):
        row, place = divmod(k, 5)
        x, y = -150.0 + 75.0 * (place if row % 2 == 0 else 4 - place), -120.0 + 80.0 * row
        name = f"row {row + 1}"
        table.add((x, y, 25.0), up, "rapid", None, name)
        for depth in (12.0, 24.0, 33.0):
            table.add((x, y, -depth), up, "cut", 260.0, name)
            table.add((x, y, 2.0), up, "cut", 3000.0, name)
        table.add((x, y, 25.0), up, "rapid", None, name)
    table.write("plate_holes.csv", "twenty holes, pecked; cell irb6700_drilling")


def write_castings() -> None:
    """s420f_handling: the gripper calls at nine castings; the guarded last 28 mm count as the process (cut)."""
    table = Table()
    for k in range(9):
        row, place = divmod(k, 3)
        x, y = 300.0 * (row - 1), 300.0 * (place if row % 2 == 0 else 2 - place) - 300.0
        name = f"casting {k + 1}"
        table.add((x, y, 150.0), (0.0, 0.0, 1.0), "link", 15000.0, name)
        table.add((x, y, 30.0), (0.0, 0.0, 1.0), "approach", 6000.0, name)
        table.add((x, y, 2.0), (0.0, 0.0, 1.0), "cut", 600.0, name)
        table.add((x, y, 150.0), (0.0, 0.0, 1.0), "retract", 6000.0, name)
    table.write("castings.csv", "nine castings on a pallet; cell s420f_handling")


def write_bone() -> None:
    """cutting_cobot: seven points 5 mm apart, 0.5 mm deep, 0.5 mm/s as in tian2025, on three tracks."""
    table = Table()
    for track, y in enumerate((-2.0, 0.0, 2.0), 1):
        lean = math.radians(4.0) * y
        axis = (0.0, math.sin(lean), math.cos(lean))
        path: list[Vector] = [(-30.0 + 5.0 * k, y, -0.5) for k in range(7)]
        name = f"track {track}"
        table.add(along(path[0], axis, 25.0), axis, "rapid", None, name)
        table.add(along(path[0], axis, 3.0), axis, "approach", 300.0, name)
        for tip in path:
            table.add(tip, axis, "cut", 30.0, name)
        table.add(along(path[-1], axis, 3.0), axis, "retract", 300.0, name)
        table.add(along(path[-1], axis, 25.0), axis, "rapid", None, name)
    table.write("bone_tracks.csv", "three short tracks on the shaft; cell cutting_cobot")


if __name__ == "__main__":
    write_plate()
    write_castings()
    write_bone()
    write_panel()
    write_contour()
    write_plain()
    write_head_face()
