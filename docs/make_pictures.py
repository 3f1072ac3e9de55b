"""Make the pictures of the documentation from what the commands write.

``python docs/make_pictures.py [FOLDER]`` writes the SVG pictures of tutorials, gallery and concept pages; CI runs it.
``python docs/make_pictures.py --report REPORT.html`` takes ``docs/report.png`` of a report in a headless Chromium.
"""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import make_diagrams
from PIL import Image

import machopt
from machopt.report.page_data.optimize_series import compute_cut_length
from machopt.report.page_data.optimize_stability_map import build_stability_map
from machopt.report.svg.stability_picture import draw_stability_map

ROOT = Path(__file__).resolve().parents[1]
PICTURES = Path(__file__).with_name("pictures")
REPORT_PICTURE = Path(__file__).with_name("report.png")
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
WIDTH, HEIGHT = 1180, 1840  # CSS pixels: verdict, robot and map of the report
COLOURS = 160  # of the palette: a third of the bytes, no visible difference
CELLS = (
    "kr500_milling",
    "kr240_drilling",
    "irb6700_drilling",
    "s420f_handling",
    "cutting_cobot",
    "kr500_rail",
    "kr240_turntable",
    "kr240_setups",
)


def make_cell_pictures(folder: Path) -> None:
    """Draw every shipped cell, and a cell that ``init`` writes.

    Args:
        folder: where the SVG files go.
    """
    for name in CELLS:
        machopt.Cell.load(ROOT / "cells" / name).validate(picture=folder / f"{name}.svg")
    with tempfile.TemporaryDirectory() as work:
        part = ROOT / "toolpaths" / "panel_holes.aptsource"
        robot = ROOT / "cells" / "kr240_drilling" / "robot.urdf"
        cell = machopt.Cell.new(robot, Path(work) / "cell", toolpath=part, tool_length_mm=320, tool_mass_kg=40)
        cell.validate(picture=folder / "own_cell.svg")


def make_plan_pictures(folder: Path) -> None:
    """Draw the rotation map of the first tutorial and the workspace map of the third.

    Args:
        folder: where the SVG files go.
    """
    cell = machopt.Cell.load(ROOT / "cells" / "kr500_milling")
    plan = machopt.optimize(cell, ROOT / "toolpaths" / "cylinder_head_face.cls")
    plan.figures.map().save(folder / "rotation_map_deck.svg")
    machopt.map(machopt.Cell.load(ROOT / "cells" / "kr240_drilling")).figures.map().save(folder / "workspace_map.svg")


def make_stability_picture(folder: Path) -> None:
    """Draw the stability over rotation and path of the shipped wall, with the rotation that avoids chatter.

    Args:
        folder: where the SVG file goes.
    """
    name = ROOT / "cells" / "kr500_milling"
    cell = machopt.Cell.load(name, process=name / "process.yaml")
    plan = machopt.optimize(cell, ROOT / "toolpaths" / "contour_5axis.csv", weights={"stability": 30})
    job = plan._made.job_result
    length = compute_cut_length(job.toolpath, job.plan.path.counted[job.points.rows])
    found = build_stability_map(job.plan, job.toolpath, length)
    assert found is not None
    drawn = str(draw_stability_map(found)).replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    style = "<style>text{font:12px sans-serif;fill:#333}</style>"
    (folder / "stability_map.svg").write_text(drawn.replace(">", f">{style}", 1) + "\n", encoding="utf-8")


def make_tolerance_picture(folder: Path) -> None:
    """Draw the outcomes of the fourth tutorial: one bar a method.

    Args:
        folder: where the SVG file goes.
    """
    name = ROOT / "cells" / "kr240_drilling"
    plan = machopt.optimize(
        machopt.Cell.load(name, process=name / "process.yaml"), ROOT / "toolpaths" / "panel_holes.aptsource"
    )
    with tempfile.TemporaryDirectory() as work:
        plan.save(Path(work) / "out")
        found = json.loads((Path(work) / "out" / "result.json").read_text(encoding="utf-8"))["process"]["in_tolerance"]
    colours = {"pass": "#2c8a57", "marginal": "#d9a30d", "fail": "#b3261e", "unknown": "#7a8490"}
    shapes = []
    rows = (("CAM default", found["before"]), ("Jiao 2022", found["before_jiao2022"]), ("this plan", found["after"]))
    for n, (label, counts) in enumerate(rows):
        x, y = 110.0, 20.0 + 44.0 * n
        shapes.append(f'<text x="100" y="{y + 19:.0f}" text-anchor="end">{label}</text>')
        total = sum(counts.values())
        for word, colour in colours.items():
            if not counts[word]:
                continue
            width = 480.0 * counts[word] / total
            shapes.append(f'<rect x="{x:.1f}" y="{y:.0f}" width="{width:.1f}" height="28" fill="{colour}"/>')
            shapes.append(
                f'<text x="{x + width / 2:.1f}" y="{y + 19:.0f}" text-anchor="middle" fill="#fff">'
                f"{counts[word]} {word}</text>"
            )
            x += width
    (folder / "holes_in_tolerance.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 610 160" width="610" height="160" '
        'font-family="sans-serif" font-size="14"><rect width="610" height="160" fill="#fff"/>'
        f"{''.join(shapes)}</svg>\n",
        encoding="utf-8",
    )


def make_diagnosis_picture(folder: Path) -> None:
    """Draw where the mismatch of the third tutorial is.

    Args:
        folder: where the SVG file goes.
    """
    with tempfile.TemporaryDirectory() as work:
        cell, plan = Path(work) / "cell", Path(work) / "plan"
        shutil.copytree(ROOT / "cells" / "kr240_drilling", cell)
        machopt.plan_poses(cell, pull_N=(500, 1000), force_N=(200, 800)).save(plan)
        script = Path(__file__).parent / "tutorials" / "simulated_robot.py"
        subprocess.run([sys.executable, script, cell, plan], check=True)
        machopt.diagnose(cell, plan / "recording_template").figures.machine().save(folder / "diagnosis_machine.svg")


def take_report_picture(report: Path) -> bytes:
    """Return the upper part of a report as PNG.

    Args:
        report: the HTML file.

    Raises:
        SystemExit: there is no browser, or it drew nothing.
    """
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"no browser: none of {', '.join(BROWSERS)} is on the path")
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        options = [
            "--headless",
            "--no-sandbox",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--hide-scrollbars",
            "--blink-settings=preferredColorScheme=1",
            f"--window-size={WIDTH},{HEIGHT}",
            f"--user-data-dir={folder}/profile",
            "--virtual-time-budget=8000",
            f"--screenshot={shot}",
        ]
        subprocess.run([browser, *options, report.resolve().as_uri()], check=True, capture_output=True, timeout=120)
        if not shot.exists():
            sys.exit(f"{browser} drew nothing of {report}")
        drawn = Image.open(shot).convert("RGB").quantize(COLOURS)
        packed = io.BytesIO()
        drawn.save(packed, "PNG", optimize=True)
    return packed.getvalue()


def main(folder: Path) -> None:
    """Make every SVG picture.

    Args:
        folder: where the files go; existing ones are replaced.
    """
    with tempfile.TemporaryDirectory() as fresh:
        made = Path(fresh)
        make_diagrams.main(made)
        make_cell_pictures(made)
        make_plan_pictures(made)
        make_tolerance_picture(made)
        make_stability_picture(made)
        make_diagnosis_picture(made)
        folder.mkdir(parents=True, exist_ok=True)
        for picture in made.iterdir():
            shutil.copy(picture, folder / picture.name)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--report"]:
        REPORT_PICTURE.write_bytes(take_report_picture(Path(sys.argv[2])))
    else:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURES)
