"""Draw the diagrams of the concept pages as SVG files: ``python docs/make_diagrams.py [FOLDER]``."""

from __future__ import annotations

import math
import sys
from html import escape
from pathlib import Path

PICTURES = Path(__file__).with_name("pictures")
INK, LIGHT, ACCENT, GOOD, BAD = "#22303c", "#e8eef4", "#1f6fb2", "#2f8f4e", "#b8392f"
STYLE = f"font-family:Helvetica,Arial,sans-serif;font-size:14px;fill:{INK}"


class Drawing:
    """An SVG drawing that grows element by element."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self.parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
            f'height="{height}" role="img" style="{STYLE}">',
            f"<title>{escape(title)}</title>",
            '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
            'orient="auto-start-reverse">'
            f'<path d="M0 0L10 5L0 10z" fill="{INK}"/></marker></defs>',
            f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
        ]

    def add_text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        anchor: str = "middle",
        size: int = 14,
        colour: str = INK,
        bold: bool = False,
    ) -> None:
        """Write one line of text."""
        weight = ' font-weight="bold"' if bold else ""
        self.parts.append(
            f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" '
            f'font-size="{size}" fill="{colour}"{weight}>{escape(text)}</text>'
        )

    def add_box(
        self, x: float, y: float, w: float, h: float, lines: list[str], *, fill: str = LIGHT, edge: str = INK
    ) -> None:
        """Draw a labelled box."""
        self.parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}" '
            f'rx="6" fill="{fill}" stroke="{edge}" stroke-width="1.5"/>'
        )
        for i, line in enumerate(lines):
            self.add_text(x + w / 2, y + h / 2 + 5 + 17 * (i - (len(lines) - 1) / 2), line, size=13)

    def add_line(
        self,
        points: list[tuple[float, float]],
        *,
        colour: str = INK,
        width: float = 1.5,
        arrow: bool = False,
        dash: str = "",
    ) -> None:
        """Draw a polyline, with an arrow head at its end if wanted."""
        path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
        extra = (' marker-end="url(#tip)"' if arrow else "") + (f' stroke-dasharray="{dash}"' if dash else "")
        self.parts.append(f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}"{extra}/>')

    def add_circle(self, x: float, y: float, r: float, *, fill: str = "none", edge: str = INK) -> None:
        """Draw a circle."""
        self.parts.append(f'<circle cx="{x:g}" cy="{y:g}" r="{r:g}" fill="{fill}" stroke="{edge}" stroke-width="1.5"/>')

    def render(self) -> str:
        """Return the SVG text."""
        return "\n".join([*self.parts, "</svg>"]) + "\n"


def draw_redundancy_angle() -> str:
    """Draw a tool that turns about its own axis while tip and axis stay."""
    d = Drawing(720, 330, "The redundancy angle: the tool turns about its axis, tip and axis stay")
    for x, angle, name in ((180, -0.5, "gamma = -30°"), (540, 0.9, "gamma = +50°")):
        d.add_line([(x - 130, 270), (x + 130, 270)], width=3)
        d.add_text(x, 295, "workpiece surface", size=12)
        d.add_line([(x, 265), (x, 70)], colour=ACCENT, width=5)
        d.add_line([(x, 60), (x, 20)], dash="5 4")
        d.add_text(x + 8, 34, "tool axis", anchor="start", size=12)
        ex, ey = x + 95 * math.sin(angle), 70 - 22 * math.cos(angle)
        d.add_line([(x, 80), (ex, ey)], width=6)
        d.add_line([(ex, ey), (ex + 60 * math.copysign(1, angle), ey + 70)], width=6)
        d.add_circle(ex, ey, 7, fill="#ffffff")
        turn = [(x + 46 * math.cos(t), 150 + 13 * math.sin(t)) for t in [0.2 + 0.1 * k for k in range(45)]]
        d.add_line(turn, colour=GOOD, arrow=True)
        d.add_text(x + 56, 158, name, anchor="start", size=13, colour=GOOD, bold=True)
        d.add_circle(x, 266, 4, fill=BAD, edge=BAD)
    d.add_text(360, 322, "Same tool tip, same tool axis, another posture of the arm, another stiffness.", size=13)
    return d.render()


def draw_configuration_grid() -> str:
    """Draw the grid of stations, rotations and branches with a sequence through it."""
    d = Drawing(720, 330, "The grid of configurations and the chosen sequence")
    free = {(s, r): not ((s in (5, 6) and r in (2, 3)) or (s == 9 and r > 3)) for s in range(13) for r in range(7)}
    way = [4, 4, 3, 3, 4, 5, 5, 4, 3, 3, 2, 2, 2]
    d.add_line([(80 + 48 * s, 50 + 34 * r) for s, r in enumerate(way)], colour=ACCENT, width=3.5)
    for (s, r), ok in free.items():
        d.add_circle(80 + 48 * s, 50 + 34 * r, 6, fill="#ffffff" if ok else BAD, edge=INK if ok else BAD)
    d.add_line([(60, 290), (690, 290)], arrow=True)
    d.add_text(375, 314, "stations along the path", size=13)
    d.add_line([(45, 270), (45, 30)], arrow=True)
    d.parts.append(
        f'<text x="26" y="150" text-anchor="middle" '
        f'font-size="13" fill="{INK}" transform="rotate(-90 26 150)">rotation × branch × turn</text>'
    )
    d.add_text(690, 22, "red: limit, singularity or collision", anchor="end", size=12, colour=BAD)
    d.add_text(80, 22, "blue: the sequence of least cost", anchor="start", size=12, colour=ACCENT)
    return d.render()


def draw_bound_and_gap() -> str:
    """Draw the values of a search: bound, sequence and smooth curve."""
    d = Drawing(720, 240, "Lower bound, sequence on the grid and driven curve on the axis of the objective J")
    d.add_line([(60, 130), (680, 130)], arrow=True)
    d.add_text(672, 155, "objective J (smaller is better)", anchor="end", size=13)
    for x, label, colour, y in (
        (250, "lower bound of the grid", GOOD, 70),
        (330, "best sequence on the grid", ACCENT, 200),
        (200, "driven smooth curve", INK, 224),
        (560, "CAM default (gamma = 0)", BAD, 70),
    ):
        d.add_line([(x, 118), (x, 142)], colour=colour, width=4)
        d.add_line([(x, 118 if y < 130 else 142), (x, y + (8 if y < 130 else -16))], colour=colour, dash="3 3")
        d.add_text(x, y, label, size=13, colour=colour)
    d.add_line([(250, 105), (330, 105)], colour=ACCENT, width=2)
    d.add_text(290, 98, "gap", size=12, colour=ACCENT)
    d.add_text(360, 24, "No sequence over the grid lies left of the bound. The curve leaves the grid and may.", size=13)
    return d.render()


def draw_optimize_stages() -> str:
    """Draw the stages of ``machopt optimize``."""
    rows = [
        ["cell.yaml, URDF,|meshes, stiffness", "CAM file"],
        ["planning path:|runs and stations", "configurations:|rotation × branch × turn", "stiffness index|and cost"],
        [
            "sequence search:|dynamic programming",
            "smooth rotation:|spline, Newton",
            "collision check|at and between points",
        ],
        ["rapid moves|and retracts", "retiming: feed,|velocity, acc., jerk", "robot programs"],
        ["independent|verification", "report and|manifest"],
    ]
    d = Drawing(720, 520, "Stages of machopt optimize")
    for k, row in enumerate(rows):
        y = 20 + 100 * k
        w = 200
        x0 = (720 - (w * len(row) + 30 * (len(row) - 1))) / 2
        for i, text in enumerate(row):
            x = x0 + i * (w + 30)
            d.add_box(x, y, w, 58, text.split("|"), fill="#fdf3e1" if k in (0, 4) else LIGHT)
            if i and k:
                d.add_line([(x - 30, y + 29), (x - 3, y + 29)], arrow=True)
        if k:
            d.add_line([(360, y - 42), (360, y - 4)], arrow=True)
    d.add_line([(590, 278), (590, 296), (145, 296), (145, 281)], colour=BAD, arrow=True, dash="5 4")
    d.add_text(
        368,
        311,
        "a collision excludes a vertex; the search repeats",
        anchor="start",
        size=12,
        colour=BAD,
    )
    return d.render()


def draw_verification() -> str:
    """Draw what the verification reads and what it does not share."""
    d = Drawing(720, 300, "The verification reads files and shares no code with the planner")
    d.add_box(30, 40, 190, 70, ["planner", "own kinematics, FCL"])
    d.add_box(
        265,
        20,
        190,
        110,
        ["output folder", "trajectory.csv, points.csv", "robot programs", "result.json, manifest"],
        fill="#fdf3e1",
    )
    d.add_box(500, 40, 190, 70, ["verification", "pinocchio, Coal"])
    d.add_line([(220, 75), (261, 75)], arrow=True)
    d.add_line([(455, 75), (496, 75)], arrow=True)
    d.add_box(265, 190, 190, 70, ["cell folder", "CAM file"], fill="#fdf3e1")
    d.add_line([(265, 215), (125, 215), (125, 114)], arrow=True)
    d.add_line([(455, 215), (595, 215), (595, 114)], arrow=True)
    d.add_line([(220, 60), (240, 10), (480, 10), (500, 60)], colour=BAD, dash="5 4")
    d.add_text(360, 290, "Every check has a test that damages a file which only this check detects.", size=13)
    d.add_text(246, 158, "no shared code (import contract)", anchor="start", size=12, colour=BAD)
    return d.render()


def draw_diagnosis_flow() -> str:
    """Draw the flow of ``machopt diagnose``."""
    steps = [
        ("recording", "load tests, measured poses or motions"),
        ("data quality", "units, swapped columns, outliers, moved tracker"),
        ("baseline", "refit the model that the cell states"),
        ("noise", "from replicates; without replicates: from the stated uncertainty"),
        ("mismatch test", "is anything repeatable left?"),
        ("forward selection", "add the effect that explains most on held-out data"),
        ("attribution guard", "does another effect explain it as well?"),
        ("hold-out validation", "unseen poses or cycles must improve"),
        ("verdict and files", "findings, intervals, detection limits, new stiffness.yaml"),
    ]
    d = Drawing(720, 60 + 62 * len(steps), "Flow of machopt diagnose")
    for i, (name, what) in enumerate(steps):
        y = 20 + 62 * i
        d.add_box(40, y, 190, 42, [name], fill="#fdf3e1" if i in (0, len(steps) - 1) else LIGHT)
        d.add_text(250, y + 26, what, anchor="start", size=13)
        if i:
            d.add_line([(135, y - 20), (135, y - 3)], arrow=True)
    y4 = 20 + 62 * 4 + 21
    d.add_line([(450, y4), (560, y4)], colour=GOOD, arrow=True, dash="4 4")
    d.add_text(570, y4 + 5, "no: consistent", anchor="start", size=13, colour=GOOD)
    d.add_line(
        [(40, 20 + 62 * 7 + 21), (18, 20 + 62 * 7 + 21), (18, 20 + 62 * 5 + 21), (37, 20 + 62 * 5 + 21)],
        colour=ACCENT,
        arrow=True,
    )
    return d.render()


def draw_index_axes() -> str:
    """Draw the directions of the stiffness index at the tool tip."""
    d = Drawing(720, 300, "Directions at the tool tip: travel, normal and tool axis")
    x, y = 330, 230
    d.add_line([(80, 250), (640, 250)], width=2)
    d.add_line([(x, y), (x, 60)], colour=ACCENT, width=4, arrow=True)
    d.add_text(x + 10, 70, "tool axis e: k_axial (drilling thrust)", anchor="start", size=13, colour=ACCENT)
    d.add_line([(x, y), (x + 190, y)], colour=GOOD, width=4, arrow=True)
    d.add_text(x + 196, y - 8, "travel t", anchor="start", size=13, colour=GOOD)
    d.add_line([(x, y), (x - 110, y - 75)], colour=BAD, width=4, arrow=True)
    d.add_text(40, y - 88, "normal e × t: k_normal (side of the cut)", anchor="start", size=13, colour=BAD)
    d.add_circle(x, y, 5, fill=INK)
    d.add_text(360, 284, "C = J K⁻¹ Jᵀ;  k(u) = 1 / (uᵀ C u);  deflection = C f", size=14)
    return d.render()


def draw_stock_contact() -> str:
    """Draw the arc of contact of a down cut and of a cutter in a corner, seen along the tool axis."""
    d = Drawing(720, 330, "Contact of the cutter with the stock, seen along the tool axis")
    for x, wall, name in ((190, 0, "straight pass: φ from 120° to 180°"), (550, 1, "corner: φ from 80° to 180°")):
        y, R = 150, 62
        d.add_box(x - 150, y + R / 2, 300, 95, [], fill="#eadfb8", edge="#b79b45")
        if wall:
            d.add_box(x + 61, y - 100, 89, 100 + R / 2, [], fill="#eadfb8", edge="#b79b45")
        cleared = [(x - 150, y + R), (x, y + R)]
        d.add_box(x - 150, y + R / 2 - 2, 150, R / 2 + 2, [], fill="#ffffff", edge="#ffffff")
        d.add_line(cleared, colour="#b79b45")
        d.add_circle(x, y, R, fill="#ffffff")
        first = math.radians(80 if wall else 120)
        arc = [first + (math.pi - first) * n / 40 for n in range(41)]
        d.add_line([(x + R * math.sin(t), y - R * math.cos(t)) for t in arc], colour=BAD, width=5)
        d.add_line([(x, y), (x + 100, y)], arrow=True)
        d.add_text(x + 84, y - 8, "travel", size=12)
        d.add_line([(x, y), (x, y - 95)], dash="4 3")
        d.add_text(x, y - 101, "φ = 0", size=12)
        d.add_line([(x + 28 * math.sin(t), y - 28 * math.cos(t)) for t in [0.04 * n for n in range(40)]], arrow=True)
        d.add_text(x, 297, name, bold=True)
    d.add_text(360, 322, "Yellow: stock. Red: where a tooth cuts. Spindle clockwise seen from the shank (M3).", size=13)
    return d.render()


def draw_stock_tilted() -> str:
    """Draw a flat end mill whose axis is parallel to a leaning wall, from the side and along its axis."""
    d = Drawing(720, 330, "Contact of a cutter whose axis turns with a conical wall")
    lean = math.radians(15)
    s, c = math.sin(lean), math.cos(lean)
    foot, top = (180, 240), (180 - 150 * s / c, 90)
    d.add_line([(40, 240), (40, 90), top, foot, (40, 240)], colour="#b79b45")
    d.add_line([(foot[0] + 14, 240), (top[0] + 14, 90), top, foot, (foot[0] + 14, 240)], colour=BAD, width=2)
    tip = (foot[0] + 45 * c + 22 * s, foot[1] - 45 * s + 22 * c)
    for side in (-45, 45):
        low = (tip[0] + side * c, tip[1] - side * s)
        d.add_line([low, (low[0] - 230 * s, low[1] - 230 * c)])
    d.add_line([(tip[0] - 45 * c, tip[1] + 45 * s), (tip[0] + 45 * c, tip[1] - 45 * s)])
    d.add_line([tip, (tip[0] - 235 * s, tip[1] - 235 * c)], dash="4 3")
    d.add_text(110, 170, "part", size=13)
    d.add_text(275, 60, "tool axis", size=13)
    d.add_text(180, 297, "side view: slices along the tool axis", bold=True)
    x, y, R, wall = 540, 190, 62, 260
    turn = [math.radians(a) for a in range(-28, 29)]
    for radius, colour in ((wall, "#b79b45"), (wall + 14, "#b79b45")):
        d.add_line([(x + radius * math.sin(t), y - R - wall + radius * math.cos(t)) for t in turn], colour=colour)
    d.add_circle(x, y, R)
    first = math.acos(((wall + R) ** 2 + R**2 - (wall + 14) ** 2) / (2 * (wall + R) * R))
    arc = [first * n / 20 for n in range(21)]
    d.add_line([(x + R * math.sin(t), y - R * math.cos(t)) for t in arc], colour=BAD, width=5)
    d.add_line([(x, y), (x + 100, y)], arrow=True)
    d.add_text(x + 84, y + 18, "travel", size=12)
    d.add_text(x, 297, "along the axis: the arc of one slice", bold=True)
    d.add_text(360, 322, "Red: allowance, and the arc in which a tooth cuts.", size=13)
    return d.render()


def draw_joint_method() -> str:
    """Draw the stages of method joint with the loop over the iterates of a window."""
    d = Drawing(1080, 175, "Windows of method joint")
    stages = (
        ("plan", "of method global"),
        ("feed advice", "largest in tolerance"),
        ("window", "rotation and speed"),
        ("exact joints", "margins, contacts"),
        ("retiming", "feed, acceleration, jerk"),
        ("accept", "shorter, in tolerance"),
    )
    width, step, y = 160, 178, 20
    for n, lines in enumerate(stages):
        x = 15 + step * n
        d.add_box(x, y, width, 56, list(lines))
        if n:
            d.add_line([(x - step + width, y + 28), (x, y + 28)], arrow=True)
    last, window = 15 + step * 5 + width / 2, 15 + step * 2 + width / 2
    d.add_line([(last, y + 56), (last, 115), (window, 115), (window, y + 56)], arrow=True)
    d.add_text((last + window) / 2, 134, "next iterate; refused: a smaller step", size=13)
    d.add_text((last + window) / 2, 154, "at last refused: the fixed path stays, with the reason", size=13)
    return d.render()


def draw_waveform_fit() -> str:
    """Draw a cutter with run-out, and measured and fitted force over one revolution with unequal teeth."""
    d = Drawing(900, 330, "Run-out of a cutter and its force over one revolution")
    x, y, R, offset = 165, 165, 92, 26
    d.add_circle(x, y, R, fill=LIGHT)
    d.add_circle(x - offset, y + offset / 2, 4, fill=BAD)
    d.add_circle(x, y, 4, fill=INK)
    d.add_line([(x - offset, y + offset / 2), (x, y)], colour=BAD, width=3)
    for j in range(3):
        angle = 0.5 + 2.0 * math.pi * j / 3
        tip = (x + R * math.sin(angle), y - R * math.cos(angle))
        d.add_line([(x, y), tip], dash="4 3")
        d.add_circle(*tip, 6, fill=ACCENT)
        d.add_text(x + 1.32 * R * math.sin(angle), y - 1.2 * R * math.cos(angle) + 5, f"tooth {j}", size=12)
    d.add_text(x - offset - 4, y + offset + 14, "spindle axis", size=12, colour=BAD)
    d.add_text(x, y + R + 48, "run-out ρ: tool axis beside the spindle axis", bold=True, size=13)
    left, right, base, height = 350, 870, 255, 190
    d.add_line([(left, base), (right, base)], arrow=True)
    d.add_line([(left, base), (left, base - height - 20)], arrow=True)
    peaks, turn = (1.0, 0.62, 0.8), 2.0 * math.pi
    curve = []
    for n in range(361):
        phase = 3.0 * n / 360
        j, within = int(phase) % 3, phase % 1.0
        curve.append((left + (right - left - 20) * n / 360, base - height * peaks[j] * math.sin(math.pi * within) ** 2))
    d.add_line(curve, colour=ACCENT, width=3)
    for n in range(0, 361, 12):
        px, py = curve[n]
        d.add_circle(px, py + 7.0 * math.sin(5.3 * turn * n / 360 + 2.1 * n), 3, fill=BAD)
    d.add_text((left + right) / 2, base + 24, "rotation of tooth 0 over one revolution", size=13)
    d.add_text(left + 8, base - height - 26, "force", anchor="start", size=13)
    d.add_text(
        (left + right) / 2, base + 54, "marks: measured, line: fit; unequal teeth show the run-out", bold=True, size=13
    )
    return d.render()


DIAGRAMS = {
    "redundancy_angle": draw_redundancy_angle,
    "configuration_grid": draw_configuration_grid,
    "bound_and_gap": draw_bound_and_gap,
    "optimize_stages": draw_optimize_stages,
    "verification": draw_verification,
    "diagnosis_flow": draw_diagnosis_flow,
    "index_axes": draw_index_axes,
    "stock_contact": draw_stock_contact,
    "stock_tilted": draw_stock_tilted,
    "joint_method": draw_joint_method,
    "waveform_fit": draw_waveform_fit,
}


def main(folder: Path) -> None:
    """Write every diagram.

    Args:
        folder: where the SVG files go.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in DIAGRAMS.items():
        (folder / f"{name}.svg").write_text(draw(), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURES)
