"""Every import is declared, and ``make run`` installs pinned versions."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LOCK, TEST_LOCK = ROOT / ".requirements.lock", ROOT / ".requirements-test.lock"
LOWEST, DOCS = ROOT / ".requirements-lowest.lock", ROOT / ".requirements-docs.lock"
DISTRIBUTION = {
    "copp_py": "copp-py",
    "tesseract_robotics": "tesseract-robotics-nanobind",
    "pinocchio": "pin",
    "coal": "coal",
    "eaik": "eaik",
    "hppfcl": "coal",
}
"""Import name → distribution, for packages that are not installed in the usual folder or may be missing."""
TOOLS = {
    "editables",
    "ruff",
    "mypy",
    "import-linter",
    "pytest-xdist",
    "pytest-cov",
}  # called as commands or loaded by pytest, never imported


def name_of(requirement: str) -> str:
    """Return the distribution name in the normalized form of the package index."""
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found, requirement
    return re.sub(r"[-_.]+", "-", found[0]).lower()


def list_declared_distributions(*extras: str) -> set[str]:
    lists = [PROJECT["dependencies"], *(PROJECT["optional-dependencies"][e] for e in extras)]
    return {name_of(r) for requirements in lists for r in requirements}


@cache
def list_imports(folder: str) -> frozenset[tuple[str, str]]:
    """Return the top-level packages that the Python files of a folder import, with the place; also late imports and
    imports by name."""
    return frozenset(_iterate_imports(folder))


def _iterate_imports(folder: str) -> Iterator[tuple[str, str]]:
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                first = node.args[0] if node.args else None
                late = node.func.attr in ("importorskip", "import_module")
                if late and isinstance(first, ast.Constant) and isinstance(first.value, str):
                    names = [first.value]
            for name in names:
                yield name.partition(".")[0], f"{file.relative_to(ROOT)}:{node.lineno}"


@cache
def known_packages() -> Mapping[str, list[str]]:
    return packages_distributions()


def list_own_modules(folder: str) -> set[str]:
    """Return modules of the same folder: tests and benchmarks import each other."""
    return {p.stem for p in (ROOT / folder).rglob("*.py")} | {p.name for p in (ROOT / folder).rglob("*") if p.is_dir()}


@pytest.mark.parametrize(
    ("folder", "extras"),
    [
        ("machopt", ("batch", "parquet", "frames", "excel")),
        ("tests", ("batch", "parquet", "frames", "excel", "dev", "compare")),
        ("benchmarks", ("batch", "parquet", "frames", "excel", "dev", "compare")),
        ("cells", ()),
        ("toolpaths", ()),
    ],
)
def test_every_import_is_declared(folder: str, extras: tuple[str, ...]) -> None:
    known = known_packages()
    mine = {"machopt", "tests", "benchmarks", "cells", "toolpaths"} | list_own_modules(folder)
    mine |= list_own_modules("tests") | list_own_modules("benchmarks") if folder in ("tests", "benchmarks") else set()
    lacking = []
    for name, where in list_imports(folder):
        if name in sys.stdlib_module_names or name in mine:
            continue
        distributions = {name_of(d) for d in known.get(name, [DISTRIBUTION.get(name, name)])}
        if not distributions & list_declared_distributions(*extras):
            lacking.append(f"{where} imports {name}, of {' or '.join(sorted(distributions))}")
    assert lacking == []


def test_every_declared_dependency_is_imported() -> None:
    known = known_packages()
    everywhere = {name for folder in ("machopt", "tests", "benchmarks") for name, _ in list_imports(folder)}
    used = {name_of(d) for name in everywhere for d in known.get(name, [DISTRIBUTION.get(name, name)])}
    assert list_declared_distributions("batch", "parquet", "frames", "excel", "dev", "compare") - used - TOOLS == set()


def test_every_dependency_has_a_lower_bound() -> None:
    """Upper bounds are set only where a newer version was tested and failed; they are listed in
    benchmarks/README.md."""
    lists = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    for requirement in (r for requirements in lists for r in requirements):
        assert re.search(r">=\d", requirement), requirement


def pins(lock: Path) -> dict[str, str]:
    text = lock.read_text(encoding="utf-8")
    return {name_of(n): v for n, v in re.findall(r"^([A-Za-z0-9._-]+)(?:\[\w+\])?==([^\s;\\]+)", text, re.MULTILINE)}


@pytest.mark.parametrize(
    ("lock", "extras"),
    [
        (LOCK, ("batch", "parquet", "excel")),
        (TEST_LOCK, ("batch", "parquet", "excel", "dev")),
        (LOWEST, ("batch", "parquet", "excel", "dev")),
    ],
)
def test_lock_files_contain_all_dependencies_with_hashes(lock: Path, extras: tuple[str, ...]) -> None:
    text = lock.read_text(encoding="utf-8")
    assert list_declared_distributions(*extras) | {"hatchling"} <= set(pins(lock))
    entries = re.split(r"^(?=[A-Za-z0-9])", text, flags=re.MULTILINE)[1:]
    assert all("--hash=sha256:" in entry for entry in entries)
    result = re.sub(r"#.*", "", text)
    assert not re.search(r"/|^-|--(?!hash=)", result, re.MULTILINE)  # no host, no path, no installer option


def test_documentation_is_built_from_pinned_packages_without_machopt() -> None:
    wanted = {name_of(r) for r in PROJECT["optional-dependencies"]["docs"]}
    text = DOCS.read_text(encoding="utf-8")
    assert wanted <= set(pins(DOCS))
    assert not {"numpy", "scipy", "pin", "numba"} & set(pins(DOCS))
    entries = re.split(r"^(?=[A-Za-z0-9])", text, flags=re.MULTILINE)[1:]
    assert all("--hash=sha256:" in entry for entry in entries)


def test_job_and_tests_use_the_same_versions() -> None:
    assert pins(LOCK).items() <= pins(TEST_LOCK).items()


def test_lowest_tested_versions_are_the_bounds() -> None:
    """`make lowest` tests exactly the lowest versions in pyproject.toml."""
    pinned = pins(LOWEST)
    extras = PROJECT["optional-dependencies"]
    lists = [PROJECT["dependencies"], extras["batch"], extras["parquet"], extras["dev"]]
    for requirement in (r for requirements in lists for r in requirements):
        bound = re.search(r">=([\d.]+)", requirement)
        assert bound is not None
        found = pinned[name_of(requirement)]
        assert numbers(found) == numbers(bound[1]), f"{requirement}: {found} is the lowest that goes with the others"


def numbers(version: str) -> tuple[int, ...]:
    """Convert a version to numbers without trailing zeros: 2.2 and 2.2.0 are the same version."""
    parts = [int(p) for p in version.split(".")]
    while parts and parts[-1] == 0:
        parts.pop()
    return tuple(parts)


def test_conda_environment_has_all_dependencies_with_the_same_bounds() -> None:
    text = (ROOT / "docs" / "install" / "environment.yml").read_text(encoding="utf-8")
    conda = {"pinocchio": "pin"}
    there = {conda.get(name_of(n), name_of(n)): v for n, v in re.findall(r"^ *- ([\w.-]+) *>=([\d.]+)$", text, re.M)}
    wanted = {name_of(r): re.search(r">=([\d.]+)", r) for r in PROJECT["dependencies"]}
    builder = re.search(r'"hatchling>=([\d.]+)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert builder is not None
    assert {n: b[1] for n, b in wanted.items() if b} | {"python": "3.11", "hatchling": builder[1]} == there


def test_container_image_copies_existing_public_files() -> None:
    image = (ROOT / "docs" / "install" / "Dockerfile").read_text(encoding="utf-8")
    copied = {name for line in re.findall(r"^COPY (.*) \S+$", image, re.M) for name in line.split()}
    assert all((ROOT / name).exists() for name in copied)
    document = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wheel = document["tool"]["hatch"]["build"]["targets"]["wheel"]
    files = [PROJECT["readme"], *PROJECT["license-files"], *wheel["packages"]]
    files += [hook["path"] for hook in wheel["hooks"].values()]  # without its hook the wheel cannot be built
    assert {"pyproject.toml", *(file.split("/")[0] for file in files)} <= copied
    observed = {t[1:] for t in (ROOT / ".dockerignore").read_text(encoding="utf-8").split() if t.startswith("!")}
    assert copied == observed


def test_every_extra_is_documented() -> None:
    message = (ROOT / "docs" / "install" / "README.md").read_text(encoding="utf-8")
    assert all(f"`{extra}`" in message for extra in PROJECT["optional-dependencies"])
