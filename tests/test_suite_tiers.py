"""Test suite tiers, expected skips and branch coverage floor; content of the wheel."""

from __future__ import annotations

import re
import tomllib
import zipfile
from collections import Counter
from pathlib import Path

import branch_coverage
import pytest
from branch_coverage import BranchCount
from conftest import (
    LONG,
    LONG_MODULE,
    LONG_TEST,
    NOTED,
    PROFILE,
    PROOFS,
    SECONDS,
    SLOW,
    is_there,
    list_long_tests,
    seconds_list,
    seconds_of,
    slow_list,
    unexpected_skips,
)
from hypothesis import settings
from property_example_count import NIGHTLY, scale_example_count

import machopt

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]


def test_skip_for_an_unlisted_reason_is_reported() -> None:
    skips = Counter({"m20ia: its meshes are not here (x)": 3, "could not import 'pyarrow'": 2})
    assert unexpected_skips(skips) == Counter({"could not import 'pyarrow'": 2})


def test_executed_modules_are_recorded_again_and_others_remain() -> None:
    known = ["tests/test_cli.py", "tests/test_suite_tiers.py::test_was_long", "tests/test_gone.py"]
    ran = {"tests/test_suite_tiers.py": LONG_MODULE - 1, "tests/test_output_damage_detection.py": LONG_MODULE}
    longest = {
        "tests/test_suite_tiers.py::test_long": LONG,
        "tests/test_suite_tiers.py::test_was_long": LONG / 2,
        "tests/test_output_damage_detection.py::test_long": LONG,  # the list already contains the module
    }
    assert slow_list(known, ran, longest) == [
        "tests/test_cli.py",
        "tests/test_output_damage_detection.py",
        "tests/test_suite_tiers.py::test_long",
    ]


def test_seconds_are_recorded_longest_first() -> None:
    known = {"tests/test_cli.py": 50.0, "tests/test_suite_tiers.py": 7.0, "tests/test_gone.py": 9.0}
    lines = seconds_list(known, {"tests/test_suite_tiers.py": NOTED / 2, "tests/test_output_damage_detection.py": 90.0})
    assert seconds_of("\n".join(lines)) == {"tests/test_output_damage_detection.py": 90.0, "tests/test_cli.py": 50.0}
    assert lines[0].endswith("tests/test_output_damage_detection.py")


def test_long_tests_are_recorded_again_and_others_remain() -> None:
    known = ["tests/test_cli.py::test_gone", "tests/test_suite_tiers.py::test_recorded_names_exist"]
    longest = {"tests/test_a.py::test_long": LONG_TEST, "tests/test_a.py::test_short": LONG_TEST / 2}
    assert list_long_tests(known, longest) == [
        "tests/test_a.py::test_long",
        "tests/test_suite_tiers.py::test_recorded_names_exist",
    ]
    assert list_long_tests(["tests/test_a.py::test_short"], longest) == ["tests/test_a.py::test_long"]


def test_recorded_names_exist() -> None:
    """A renamed test would run in `make quick` again, however long it takes."""
    names = [name for file in (SLOW, PROOFS) for name in file.read_text(encoding="utf-8").split()]
    names += seconds_of(SECONDS.read_text(encoding="utf-8"))
    assert [name for name in names if not is_there(name)] == []


def test_examples_are_fixed_in_ci_and_many_in_nightly() -> None:
    assert settings.default is not None
    if PROFILE == "ci":
        assert settings.default.derandomize
    assert settings.default.deadline is None
    assert scale_example_count(30) == (600 if NIGHTLY else 30)


def test_branches_are_summed_by_package_and_compared_with_the_floor() -> None:
    files = [
        BranchCount("planning/a.py", 9, 10),
        BranchCount("planning/cost/b.py", 81, 90),
        BranchCount("kinematics/x.py", 8, 10),
        BranchCount("measurement/estimation/x.py", 94, 100),
        BranchCount("measurement/design/x.py", 1, 2),
        BranchCount("errors.py", 0, 0),
    ]
    packages = branch_coverage.sum_by_package(files)
    assert [(p.name, p.taken, p.all) for p in packages] == [
        ("errors.py", 0, 0),
        ("kinematics", 8, 10),
        ("measurement", 1, 2),
        ("measurement/estimation", 94, 100),
        ("planning", 90, 100),
    ]
    wrong = branch_coverage.find_packages_below_floor(packages)
    assert "kinematics: 80.0 % of 10 branches, less than 90 %" in wrong
    assert "effects was not measured" in wrong
    assert "measurement/estimation: 94.0 % of 100 branches, less than 95 %" in wrong
    assert not any(line.startswith(("planning", "measurement:")) for line in wrong)


def test_every_package_of_the_floor_is_a_layer() -> None:
    layers = PYPROJECT["tool"]["importlinter"]["contracts"][0]["layers"]
    known = {name.strip() for layer in layers for name in layer.split("|")}
    for name in branch_coverage.FLOOR:
        assert (ROOT / "machopt" / name).is_dir()
        assert name.partition("/")[0] in known


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.Path:
    from hatchling.builders.wheel import WheelBuilder

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(
            "MACHOPT_KERNELS", "0"
        )  # compiling them takes a minute; tests/test_kernel_compilation.py tests them
        (made,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("wheel")), versions=["standard"])
    return zipfile.Path(made)


def test_wheel_is_typed_and_contains_no_extra_files(wheel: zipfile.Path) -> None:
    names = wheel.root.namelist()
    assert "machopt/py.typed" in names
    assert not [n for n in names if re.search(r"\.(orig|rej|pyc|nbi|nbc|bak)$|__pycache__|^tests/", n)]
    assert any(n.endswith("licenses/LICENSE") for n in names)
    assert not [n for n in names if n.startswith("machopt/kernels")]  # as MACHOPT_KERNELS requests


def test_version_has_one_source(wheel: zipfile.Path) -> None:
    assert "version" in PROJECT["dynamic"]
    name = f"machopt-{machopt.__version__}.dist-info/METADATA"
    metadata = (wheel / name).read_text(encoding="utf-8")
    assert f"\nVersion: {machopt.__version__}\n" in metadata
    output = {line.removeprefix("Classifier: ") for line in metadata.splitlines() if line.startswith("Classifier: ")}
    assert set(PROJECT["classifiers"]) <= output


def test_classifiers_agree_with_the_required_python() -> None:
    """The build of the wheel checks that the package index accepts them."""
    lowest = re.search(r">=(3\.\d+)", PROJECT["requires-python"])
    assert lowest is not None
    assert f"Programming Language :: Python :: {lowest[1]}" in PROJECT["classifiers"]


def test_hooks_are_the_steps_of_make_lint() -> None:
    import yaml

    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    assert [r["repo"] for r in hooks] == ["local"]  # no download
    entries = {h["entry"].removeprefix(".venv/bin/").replace(" .", "") for r in hooks for h in r["hooks"]}
    steps = re.search(r"^lint:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert steps is not None
    assert entries == {line.strip().removeprefix("$(BIN)/").removesuffix(" .") for line in steps[1].splitlines()}
