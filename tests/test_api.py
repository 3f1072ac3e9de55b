"""Python API: public names, options, and files equal to those of the commands."""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import inspect
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from output_damage.damage_case import CELLS, HEADER, PASS

import machopt
import machopt.api
from machopt.api.error_message_translation import RENAMED as RENAMED_OPTIONS
from machopt.api.error_message_translation import replace_option_names
from machopt.api.request_options import NON_OPTION_ARGUMENTS, build_request, list_option_names
from machopt.cli import _build_parser
from machopt.commands.plan_poses.run import run_plan_poses
from machopt.errors import OptionError, UnknownOptionError
from machopt.measurement.design.request import PosesRequest
from machopt.measurement.diagnosis.request import DiagnoseRequest
from machopt.measurement.identification.request import IdentifyRequest
from machopt.verification.folder.folder_checks import check_parquet_copies
from machopt.workspace_map.request import MapRequest

ROOT = Path(__file__).resolve().parents[1]

KR500 = CELLS / "kr500_milling"
ELSEWHERE = {"InputError", "MachoptError", "VerificationError", "__version__"}


def test_public_names_exist_and_are_documented() -> None:
    assert machopt.__all__ == sorted(machopt.__all__)
    assert set(machopt.__all__) == set(machopt.api.__all__) | ELSEWHERE
    assert set(machopt.__all__) <= set(dir(machopt))
    for name in machopt.api.__all__:
        thing = getattr(machopt, name)
        assert thing is getattr(machopt.api, name)
        assert inspect.getdoc(thing), name
        if inspect.isfunction(thing):
            assert "Raises:" in (thing.__doc__ or ""), name
            untyped = [p.name for p in inspect.signature(thing).parameters.values() if p.annotation is p.empty]
            assert not untyped, name
    with pytest.raises(AttributeError):
        machopt.no_such_name  # noqa: B018


@pytest.mark.parametrize(
    ("call", "where"),
    [
        (lambda: machopt.diagnose("cells/kr240_drilling", 3), "recordings"),  # type: ignore[arg-type]
        (lambda: machopt.diagnose(3, "r"), "cell"),  # type: ignore[arg-type]
        (lambda: machopt.diagnose("c", "r", max_findings="two"), "max_findings"),
        (lambda: machopt.identify("cells/kr240_drilling", [3]), "recordings"),  # type: ignore[list-item]
        (lambda: machopt.identify("cells/kr240_drilling", "r", robust="a"), "robust"),
        (lambda: machopt.optimize("cells/kr240_drilling", 3), "toolpath"),  # type: ignore[arg-type]
        (lambda: machopt.map("cells/kr240_drilling", slice=3), "slice"),
        (lambda: machopt.place("cells/kr240_drilling", 3), "toolpaths"),  # type: ignore[arg-type]
        (lambda: machopt.plan_poses("cells/kr240_drilling", poses="x"), "poses"),
        (lambda: machopt.batch(3, "out"), "jobs"),  # type: ignore[arg-type]
        (lambda: machopt.batch("jobs.yaml", 3), "out"),  # type: ignore[arg-type]
        (lambda: machopt.batch("jobs.yaml", "out", cell=3), "cell"),  # type: ignore[arg-type]
        (lambda: machopt.batch("jobs.yaml", "out", effects=[3]), "effects"),  # type: ignore[list-item]
        (lambda: machopt.batch("jobs.yaml", "out", workers="two"), "workers"),
    ],
)
def test_value_of_a_wrong_type_is_refused_with_the_option_name(call: Callable[[], object], where: str) -> None:
    with pytest.raises(machopt.InputError, match=rf"{where}: found .*(would work|expected)"):
        call()


def test_table_representation_is_short_and_escaped() -> None:
    table = machopt.Table({"<x>": np.arange(20.0), "why": np.array(["a & b"] * 20)})
    shown = table._repr_html_()
    assert "<th>&lt;x&gt;</th>" in shown
    assert shown.count("a &amp; b") == 8
    assert "20 rows, 2 columns" in shown


def test_subpackage_of_the_same_name_does_not_hide_a_function() -> None:
    import machopt.measurement.diagnosis.request
    import machopt.measurement.identification.fitting.weighted_fit

    assert inspect.isfunction(machopt.identify)
    assert inspect.isfunction(machopt.diagnose)
    from machopt.measurement.identification import request as module

    assert inspect.ismodule(module)


def test_package_imports_nothing_before_first_use() -> None:
    code = "import machopt, sys; print('numpy' in sys.modules, any(m.startswith('machopt.api') for m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["False", "False"]
    done = subprocess.run(
        [sys.executable, "-m", "machopt", "--version"], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout == f"machopt {machopt.__version__}\n"


RENAMED = {"anchors": "anchors_mm", "tracker": "tracker_mm", "prior": "prior_Nm_per_rad", "plan": "plan_file"}


@pytest.mark.parametrize(
    ("command", "request_type"),
    [
        (["identify", "c", "r", "-o", "o"], IdentifyRequest),
        (["diagnose", "c", "r", "-o", "o"], DiagnoseRequest),
        (["map", "c", "-o", "o"], MapRequest),
        (["plan-poses", "c", "-o", "o"], PosesRequest),
    ],
    ids=["identify", "diagnose", "map", "plan-poses"],
)
def test_command_and_function_have_the_same_options_and_defaults(command: list[str], request_type: type[Any]) -> None:
    args = vars(_build_parser().parse_args(command))
    by_field = {RENAMED.get(name, name): value for name, value in args.items()}
    fields = {f.name: f for f in dataclasses.fields(request_type)}
    shared = [name for name in list_option_names(request_type) if name in by_field]
    assert len(shared) > 0.6 * len(list_option_names(request_type))
    for name in shared:
        value = by_field[name]
        assert fields[name].default == (tuple(value) if isinstance(value, list) else value), name


def test_unknown_option_is_answered_with_the_nearest() -> None:
    with pytest.raises(UnknownOptionError) as unknown:
        build_request(DiagnoseRequest, {"max_finding": 2}, cell=Path("c"), recordings=(), out=Path())
    assert (unknown.value.option, unknown.value.suggestions) == ("max_finding", ("max_findings",))
    with pytest.raises(machopt.InputError, match=r"rotation_stepp_deg.*rotation_step_deg"):
        machopt.optimize(KR500, CELLS.parent / "toolpaths" / "plain.csv", rotation_stepp_deg=3)
    with pytest.raises(machopt.InputError, match=r"no cell\.yaml"):
        machopt.Cell.load(CELLS)
    assert set(NON_OPTION_ARGUMENTS) >= {"cell", "out"}


def test_errors_name_arguments_in_python_and_options_on_the_command_line(tmp_path: Path) -> None:
    """The same error names the argument in Python and the option on the command line."""
    with pytest.raises(OptionError) as found:
        machopt.plan_poses(KR500, weights_kg=[20], min_kci=2.0)
    assert (found.value.where, found.value.argument, found.value.option) == ("min_kci", "min_kci", "--min-kci")
    assert "--" not in str(found.value)
    with pytest.raises(machopt.InputError) as found:
        machopt.plan_poses(KR500, anchors_mm=[[1, 2, 3]])
    assert str(found.value).startswith("anchors_mm: ")
    assert "pull_N=200,500" in str(found.value)
    assert "--" not in str(found.value)
    with pytest.raises(machopt.InputError) as typed:
        run_plan_poses(PosesRequest(cell=KR500, out=tmp_path / "out", anchors_mm=((1.0, 2.0, 3.0),)))
    assert typed.value.where == "--anchors"
    assert "--pull-N 200,500" in str(typed.value)
    with pytest.raises(OptionError) as found:
        machopt.Toolpath.read(CELLS.parent / "toolpaths" / "plain.csv", unit="furlong")
    assert found.value.where == "unit"


@pytest.mark.parametrize(
    ("text", "renamed"),
    [
        ("--pull-N 200,500 would work", "pull_N=200,500 would work"),
        ("--set force_N={axial: 200} as in the run", "force_N={axial: 200} as in the run"),
        ("without --toolpath and --force-N it would work", "without toolpath and force_N it would work"),
        ("with --fit and --post", "with terms and posts"),
        ("a table --- or -- a line", "a table --- or -- a line"),
        ("--tool-axis=+z", "tool_axis=+z"),
        ("--x-mm -300 300 would work", "x_mm=-300 300 would work"),
    ],
)
def test_options_in_a_message_become_arguments(text: str, renamed: str) -> None:
    assert replace_option_names(text, RENAMED_OPTIONS) == renamed


def test_values_are_accepted_in_any_equivalent_form() -> None:
    request = build_request(
        PosesRequest,
        {"weights_kg": [20, 50], "discriminate": "folder", "anchors_mm": [[1, 2, 3]], "terms": "a@b"},
        cell=Path("c"),
        out=Path(),
        effects=(),
    )
    assert request.weights_kg == (20, 50)
    assert request.discriminate == Path("folder")
    assert request.anchors_mm == ((1, 2, 3),)
    assert request.terms == ("a@b",)


def test_tables_are_read_only_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    table = machopt.Table({"x_mm": np.array([1.0, np.nan]), "status": np.array(["ok", "bounds"])})
    assert list(table) == ["x_mm", "status"]
    assert (len(table), table.rows) == (2, 2)
    with pytest.raises(ValueError, match="read-only"):
        table["x_mm"][0] = 2.0
    with pytest.raises(KeyError, match="did you mean 'status'"):
        table["stauts"]
    assert table.array("x_mm").shape == (2, 1)
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(machopt.InputError, match="needs pandas"):
        table.frame()
    with pytest.raises(machopt.InputError, match="needs pyarrow"):
        table.arrow()


def test_figures_are_svg(tmp_path: Path) -> None:
    figure = machopt.Figure("<svg/>")
    assert figure.save(tmp_path / "a.svg").read_text().startswith("<svg/>\n")
    with pytest.raises(machopt.InputError, match=r"a\.svg would work"):
        figure.save(tmp_path / "a.png")


def verified_copies(folder: Path) -> list[tuple[str, bool | None]]:
    """Return the verification results of a folder's Parquet tables."""
    return [(c.name, c.passed) for c in check_parquet_copies(folder)]


@pytest.mark.slow
def test_saved_files_equal_those_of_the_command(
    tmp_path: Path, shipped_plan: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Except for times in result.json and the report, and their hashes in the manifest."""
    toolpath = tmp_path / "pass.csv"
    rows = "".join(f"{x},{y},{z},0,0,1,{move},{feed}\n" for x, y, z, move, feed in PASS)
    toolpath.write_text(f"{HEADER}\n{rows}")
    by_command = shipped_plan(KR500, toolpath, "--post", "krl", "--set", "rotation_step_deg=10")
    capsys.readouterr()
    cell = machopt.Cell.load(str(KR500))
    plan = machopt.optimize(cell, toolpath, posts=["krl"], rotation_step_deg=10, tables="parquet")
    shown = plan._repr_html_()  # the display in a notebook
    assert "<th>cycle time</th>" in shown
    assert f"<td>{plan.cycle_time_s:.1f} s</td>" in shown
    assert f"<td>{np.nanmax(plan.deflection):.3f} mm</td>" in shown
    assert f": {plan.verdict}" in shown
    assert plan.feasible
    assert plan.points.rows == len(plan.toolpath) == len(plan.joints) == len(plan.deflection)
    assert plan.trajectory is not None
    assert plan.trajectory["time_s"][-1] == pytest.approx(plan.cycle_time_s)
    assert plan.figures.map().svg.startswith("<svg")
    assert plan.verify().ok
    result = plan.save(tmp_path / "out")
    assert capsys.readouterr() == ("", "")
    assert result.exit_code == 0
    timed = {"result.json", "report.html", "manifest.json"}
    copies = {"points.parquet", "rapid_corners.parquet", "trajectory.parquet"}
    table = pytest.importorskip("pyarrow.parquet").read_table(tmp_path / "out" / "points.parquet")
    for name in ("x_mm", "q3_deg", "deflection_mm"):
        np.testing.assert_array_equal(np.array(table[name], float), plan.points[name])
    assert verified_copies(tmp_path / "out") == [("Parquet tables", True)]
    (tmp_path / "out" / "points.parquet").write_bytes((tmp_path / "out" / "trajectory.parquet").read_bytes())
    assert verified_copies(tmp_path / "out") == [("Parquet tables", False)]
    files = {p.relative_to(by_command).as_posix() for p in by_command.rglob("*") if p.is_file()}
    made = {p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    assert made == files | copies
    assert len(files - timed) > 2
    for name in files - timed:
        assert (tmp_path / "out" / name).read_bytes() == (by_command / name).read_bytes(), name
    message, expected = (json.loads((f / "result.json").read_text()) for f in (tmp_path / "out", by_command))
    assert all(message["outputs"].pop(name) for name in copies)
    for value in (message, expected):
        del value["timings_s"], value["outputs"]["report.html"]
    assert message == expected


def test_planning_refuses_a_cell_that_has_changed(tmp_path: Path) -> None:
    import shutil

    shutil.copytree(KR500, tmp_path / "cell")
    cell = machopt.Cell.load(tmp_path / "cell")
    file = tmp_path / "cell" / "stiffness.yaml"
    other = cell.with_stiffness(shutil.copy(file, tmp_path / "other.yaml"))
    assert other.joint_stiffness is not None
    assert cell.joint_stiffness is not None
    assert (other.joint_stiffness == cell.joint_stiffness).all()
    file.write_text(file.read_text() + "# seen again\n")
    with pytest.raises(machopt.InputError, match=r"stiffness.yaml.*has changed"):
        cell.unchanged()


def test_every_command_has_a_function_or_is_listed_as_without() -> None:
    (commands,) = (a for a in _build_parser()._actions if isinstance(a, argparse._SubParsersAction))
    functions = {n.replace("_", "-") for n in machopt.__all__ if inspect.isfunction(getattr(machopt, n))}
    parts_of_a_command = {
        "fit-cutting-coefficients",
        "identify-frequency-responses",
    }  # parts of process and of identify
    assert functions - parts_of_a_command <= set(commands.choices)


def test_option_types_are_current() -> None:
    """The generated option types equal those of the requests and schemas."""
    spec = importlib.util.spec_from_file_location("make_option_types", ROOT / "docs" / "make_option_types.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.MODULE.read_text(encoding="utf-8") == module.build_module(), "run python docs/make_option_types.py"


def test_type_checker_finds_a_wrong_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The type checker reports ``rotation_stp_deg``.

    It uses the cache of ``make lint`` if there is one; the package itself is checked there.
    """
    monkeypatch.chdir(ROOT)
    mypy = pytest.importorskip("mypy.api")
    code = tmp_path / "wrong.py"
    code.write_text('import machopt\n\nmachopt.optimize("cell", "part.cls", rotation_stp_deg=2.5)\n', encoding="utf-8")
    cold = ["--follow-imports=silent", f"--cache-dir={tmp_path / 'cache'}"]
    found, _, status = mypy.run([str(code), *([] if (ROOT / ".mypy_cache").is_dir() else cold)])
    assert status == 1
    assert "rotation_stp_deg" in found
