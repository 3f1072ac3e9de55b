"""Table of thresholds: meaning and origin of each."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from machopt.measurement import thresholds

ROOT = Path(__file__).resolve().parent.parent


def test_every_threshold_has_meaning_and_origin() -> None:
    rows = list(thresholds.list_thresholds())
    assert len({(r.concern, r.name) for r in rows}) == len(rows)
    assert 50 < len(rows) <= 80
    for row in rows:
        assert row.meaning
        assert row.value == row.value  # not NaN
        assert row.origin.method in ("measured", "statistics", "published", "judgement")
        if row.origin.method == "measured":
            assert (ROOT / row.origin.script).is_file()
            assert row.origin.cases in ("dev", "sealed")
            assert len(row.origin.date) == len("2026-11-21")


def test_statistical_thresholds_are_recomputed() -> None:
    """All other thresholds are choices, and their origin says so."""
    follows = {
        "levels.gain_two_sigma": 2.0**2,
        "levels.gain_three_sigma": 3.0**2,
        "levels.power_quantile": norm.ppf(0.9),
        "levels.two_sigma": 2.0,
        "levels.three_sigma": 3.0,
        "levels.difference_sigma": 3.0 * 2.0**0.5,
        "counts.min_comparisons": np.ceil(-np.log2(0.05)),
        "counts.min_groups": np.ceil(-np.log2(0.005)),
        "counts.min_degrees_of_freedom": np.floor(1.0 / (2.0 * 0.2**2)),
        "shares.majority": 0.5,
        "shares.half_power_amplitude": 0.5**0.5,
        "shares.max_relative_error": 1.0 / 2.0,
    }
    values = {t.key: t.value for t in thresholds.list_thresholds() if t.origin.method == "statistics"}
    assert values == pytest.approx(follows, rel=2e-3)


def test_script_prints_the_table() -> None:
    output = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "diagnosis_thresholds.py")],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    ).stdout
    for row in thresholds.list_thresholds():
        assert f"{row.concern.lower()}.{row.name}" in output


NO_DECISION = {  # constants that decide nothing: guards against rounding, units, steps, grid ends, a stated load
    "dynamic.friction.REVERSAL_WIDTH_FACTOR",
    "discrimination.required_measurements.POSE_GROWTH",  # step of the search for a sufficiently large plan
    "discrimination.required_measurements.HARDER_FORM_SHARE",  # which forms of a rival are simulated
    "static.measured_pose_hypothesis_catalogue.ROUNDING",
    "static.load_test_channel.RIGID",
    "static.bearing_tilt.ANY_DIRECTION",
    "discrimination.predicted_signals.CYCLE_GAP",
    "discrimination.predicted_signals.PARAMETER_TOLERANCE",
    "effect_columns.gravity_compensator.ANGLE",
    "effect_columns.gravity_compensator.RATIO",
    "effect_columns.joint_torque.LEAST_SOFT",
    "model_selection.attribution.compensator_or_harmonics.ANGLES",
    "model_selection.attribution.compensator_or_harmonics.ZERO_SINGULAR_VALUE",
    "model_selection.attribution.compensator_or_harmonics.SIDE",
    "model_selection.search.shape_refinement.GAIN_ROUNDING",
    "model_selection.search.shape_refinement.MAX_GAIN_ROUNDING",
    "model_selection.search.shape_refinement.NARROW",
    "model_selection.search.shape_refinement.NARROWER",
    "model_selection.search.progress_messages.REPORT_INTERVAL",
    "statistics.fold_rows.MAX_PADDING",  # affects only the speed of the products
    "statistics.normal_equations_by_fold.MIN_COLUMN_SQUARE",
    "statistics.normal_equations_by_fold.RIDGE",
    "dynamic.time_delays.LONGEST",
    "effect_columns.motion_columns.ARCMIN",
    "effect_columns.motion_columns.ARCSEC",
    "dynamic.secondary_encoder_channel.DEFAULT_LOAD_RANGE",
    "dynamic.next_motion.RATE",
    "dynamic.next_motion.JOINT_LIMIT_MARGIN",
    "dynamic.next_motion.SECONDS",
    "data_quality.misplaced_reflectors.LOOSE_UNCERTAINTY_FACTOR",
    "statistics.replicate_noise.LEAST_SIGMA",
    "outputs.effect_on_toolpath.TEST_FORCE",
    "outputs.corrected_recording.MM",
    "outputs.written_model_error.CONVERGED_M",
    "outputs.written_model_error.UNDETERMINED",
    "model_selection.evaluation.fold_fits.FIXED",
    "model_selection.evaluation.finding_estimates.ROUND_OFF",
    "effect_columns.gravity_compensator.EQUIVALENT_RCOND",
}


def test_module_constants_that_decide_are_thresholds() -> None:
    """A float constant of a module is a threshold in ``thresholds.py``, unless this list states that it decides
    nothing."""
    folder = ROOT / "machopt" / "measurement" / "diagnosis"
    found = set()
    for path in sorted(folder.rglob("*.py")):
        where = path.relative_to(folder).with_suffix("")
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and len(node.targets) == 1:
                pairs = _pairs(node.targets[0], node.value)
                found |= {".".join((*where.parts, name)) for name, value in pairs if _float(value)}
    assert found == NO_DECISION


IN_THE_OPEN = {  # literals in comparisons: rounding, constants of a calculation, text formatting
    ("discrimination/required_measurements.py", 4.0): "variance of a sum, worked out",
    ("statistics/whitening.py", 1e-6): "rounding of singular values",
    ("dynamic/secondary_encoder_channel.py", 1e-6): "a constant column",
    ("dynamic/motion_record_checks.py", 1e3): "millimetres",
    ("dynamic/motion_channels.py", 1e-6): "a constant column",
    ("data_quality/session_corrections.py", 0.5): "root of a threshold: of misfits, not of their squares",
    ("model_selection/finding_validation.py", 1e-4): "a share of nothing is no number",
    ("model_selection/finding_validation.py", 0.9): "of which quantile that share is",
    ("model_selection/evaluation/finding_estimates.py", 0.975): "both tails of 95 %",
    ("model_selection/evaluation/finding_estimates.py", 0.025): "a tail of 95 %, shared by all coefficients",
    ("verdict/transmission_error_naming.py", 1e-6): "rounding of a wave's order",
    ("verdict/verdict_text.py", 0.5): "millimetres or micrometres",
    ("verdict/verdict_text.py", 1e3): "digits",
    ("verdict/verdict_text.py", 1e5): "digits",
}


def test_comparisons_use_named_thresholds() -> None:
    """Every decision threshold has a name and a row in the table; zero, one and a factor of two are no thresholds."""
    folder = ROOT / "machopt" / "measurement" / "diagnosis"
    found = set()
    for path in sorted(folder.rglob("*.py")):
        where = path.relative_to(folder)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Compare):
                continue
            if not all(isinstance(op, ast.Eq | ast.NotEq | ast.Is | ast.IsNot | ast.In | ast.NotIn) for op in node.ops):
                numbers = (n.value for n in ast.walk(node) if isinstance(n, ast.Constant) and type(n.value) is float)
                found |= {(where.as_posix(), v) for v in numbers if v not in (0.0, 1.0, 2.0) and v >= 1e-8}
    assert found == set(IN_THE_OPEN)


def _pairs(target: ast.expr, value: ast.expr) -> list[tuple[str, ast.expr]]:
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        return [p for t, v in zip(target.elts, value.elts, strict=True) for p in _pairs(t, v)]
    return [(target.id, value)] if isinstance(target, ast.Name) else []


def _float(value: ast.expr) -> bool:
    """Return whether the value contains a float literal, alone, negative, or in a call or a product:
    ``np.radians(1.0)``."""
    if isinstance(value, ast.Tuple | ast.List | ast.Dict):
        return False  # grids and tables are no thresholds
    return any(isinstance(n, ast.Constant) and isinstance(n.value, float) for n in ast.walk(value))


def test_threshold_is_set_for_a_block_and_restored() -> None:
    code = (
        "import diagnosis_thresholds as t\n"
        "from machopt.measurement import thresholds\n"
        "before = thresholds.LEVELS.min_gain\n"
        "with t.set_threshold('levels.min_gain', 20.0):\n"
        "    assert thresholds.LEVELS.min_gain == 20.0\n"
        "assert thresholds.LEVELS.min_gain == before != 20.0\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT / "benchmarks")
