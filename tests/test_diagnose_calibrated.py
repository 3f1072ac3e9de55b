"""The table of thresholds: each says what it is and where it comes from, and what it names is there."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

from machopt.diagnose import calibrated

ROOT = Path(__file__).resolve().parent.parent


def test_every_threshold_says_what_it_is_and_where_its_number_comes_from() -> None:
    rows = list(calibrated.every())
    assert len({(r.concern, r.name) for r in rows}) == len(rows) > 50
    for row in rows:
        assert row.why
        assert row.value == row.value  # a number
        assert row.origin.how in ("measured", "statistics", "judgement")
        if row.origin.how == "measured":
            assert (ROOT / row.origin.script).is_file()
            assert row.origin.cases in ("dev", "sealed")
            assert len(row.origin.date) == len("2026-11-21")


def test_the_script_prints_the_table_again() -> None:
    said = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "thresholds.py")],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    ).stdout
    for row in calibrated.every():
        assert f"{row.concern.lower()}.{row.name}" in said


NO_DECISION = {  # constants beside the computation: guards against rounding, units, ends of grids, a stated load
    "moving.friction.WIDER",
    "resting.absolute_catalogue.ROUNDING",
    "apart.predicted.REST",
    "apart.predicted.SAME",
    "laws.at_joint.LEAST_SOFT",
    "search.finer.NARROW",
    "search.finer.NARROWER",
    "evidence.grams.NOTHING",
    "evidence.grams.RIDGE",
    "moving.clock.LONGEST",
    "laws.motion_frame.ARCMIN",
    "laws.motion_frame.ARCSEC",
    "moving.link.MOVING",
    "moving.next_motion.RATE",
    "moving.next_motion.ROOM",
    "moving.next_motion.SECONDS",
    "record.nests.LOOSE",
    "evidence.noise.LEAST_SIGMA",
    "written.onjob.TEST_FORCE",
}


def test_a_number_that_decides_stands_in_the_table() -> None:
    """A float of a module is a threshold, of ``diagnose/calibrated``, unless this list says that it decides nothing."""
    folder = ROOT / "machopt" / "diagnose"
    found = set()
    for path in sorted(folder.rglob("*.py")):
        where = path.relative_to(folder).with_suffix("")
        if where.parts[0] == "calibrated":
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and len(node.targets) == 1:
                pairs = _pairs(node.targets[0], node.value)
                found |= {".".join((*where.parts, name)) for name, value in pairs if _float(value)}
    assert found == NO_DECISION


def _pairs(target: ast.expr, value: ast.expr) -> list[tuple[str, ast.expr]]:
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        return [p for t, v in zip(target.elts, value.elts, strict=True) for p in _pairs(t, v)]
    return [(target.id, value)] if isinstance(target, ast.Name) else []


def _float(value: ast.expr) -> bool:
    """A number with a point, alone, negative, or inside a call or a product: ``np.radians(1.0)``."""
    if isinstance(value, ast.Tuple | ast.List | ast.Dict):
        return False  # grids and tables
    return any(isinstance(n, ast.Constant) and isinstance(n.value, float) for n in ast.walk(value))
