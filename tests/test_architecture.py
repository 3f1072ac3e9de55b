"""Architecture rules: import layers, layout, file length, start-up time."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "machopt"

TOP_LEVEL = {
    "pyproject.toml",
    "machopt",
    "tests",
    "cells",
    "toolpaths",
    "README.md",
    "LICENSE",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "Makefile",
    "benchmarks",
    "docs",
}
MADE = {"out", "build", "dist"}  # created by commands; ignored by git

MOST_LINES = 400  # of code, without docstrings, comments and blank lines
COMMAND_LINES = 120  # of code
LONGER_COMMANDS = {"place/document.py": "the document, table and page data of place, which has no package of its own"}
LONGER: dict[str, str] = {}  # file: reason for its length

HEAVY = (
    "pinocchio",
    "scipy",
    "trimesh",
    "fcl",
    "plotly",
    "numba",
    "ssik",
    "ruckig",
    "pyarrow",
    "xacro",
    "distributed",
    "psutil",
)


@dataclass(frozen=True)
class SourceFile:
    text: str
    tree: ast.Module


@pytest.fixture(scope="module")
def sources() -> dict[Path, SourceFile]:
    """Read and parse every file of the package once."""
    texts = {path: path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")}
    return {path: SourceFile(text, ast.parse(text)) for path, text in texts.items()}


def list_definitions(body: list[ast.stmt]) -> Iterator[ast.ClassDef | ast.FunctionDef]:
    """Yield classes and functions of a body, including nested ones; code does not define any elsewhere."""
    for node in body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node
            yield from list_definitions(node.body)


def count_code_lines(source: SourceFile) -> int:
    """Count lines of code, without docstrings, comments and blank lines."""
    text = source.text
    documented = {
        line
        for node in [source.tree, *list_definitions(source.tree.body)]
        if ast.get_docstring(node, clean=False)
        for line in range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1)
    }
    fixed = {n for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.lstrip().startswith("#")}
    return len(fixed - documented)


def python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_imports_follow_the_layers() -> None:
    pytest.importorskip("importlinter")
    out = python("from importlinter.cli import lint_imports_command; lint_imports_command(['--no-cache'])")
    assert "0 broken" in out


def test_imports_have_no_cycles() -> None:
    """Cycles are forbidden within a package, too; late imports and imports for type checkers count."""
    grimp = pytest.importorskip("grimp")
    graph = grimp.build_graph("machopt", exclude_type_checking_imports=False, cache_dir=None)
    assert len(graph.modules) > 400
    arrows = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    list(TopologicalSorter(arrows).static_order())  # CycleError names the modules of a cycle


def test_walk_from_the_command_to_an_effect_law_has_eight_files() -> None:
    """In the documented sequence each file is imported by one before it, and the law by the registry."""
    grimp = pytest.importorskip("grimp")
    graph = grimp.build_graph("machopt", exclude_type_checking_imports=True, cache_dir=None)
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    match = re.search(r"^From the command to a law: (.*?): eight\s", text, re.DOTALL | re.MULTILINE)
    assert match is not None
    files = re.findall(r"`([\w/]+\.py)`", match[1])
    assert len(files) == 8
    walk = ["machopt." + name.removesuffix(".py").replace("/", ".") for name in files]
    law = next(m for m in walk if m.startswith("machopt.effects."))
    for n, module in enumerate(walk[1:], start=1):
        doors = ("machopt.effects.registry",) if module == law else walk[:n]
        assert any(graph.direct_import_exists(importer=door, imported=module) for door in doors), module
    rooms = [m for m in walk[: walk.index(law)] if "." in m]
    assert any(graph.direct_import_exists(importer=m, imported="machopt.effects.registry") for m in rooms)


def test_walk_from_the_command_to_the_cost_of_a_plan_has_eight_files() -> None:
    """In the documented sequence each file is imported by one before it, and the last file contains the cost."""
    grimp = pytest.importorskip("grimp")
    graph = grimp.build_graph("machopt", exclude_type_checking_imports=True, cache_dir=None)
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    match = re.search(r"^From the command to a price of a plan.*?: (`.*?): eight files", text, re.DOTALL | re.MULTILINE)
    assert match is not None
    files = re.findall(r"`([\w/]+\.py)`", match[1])
    assert len(files) == 8
    walk = ["machopt." + name.removesuffix(".py").replace("/", ".") for name in files]
    for n, module in enumerate(walk[1:], start=1):
        assert any(graph.direct_import_exists(importer=door, imported=module) for door in walk[:n]), module
    assert "w.clearance" in (PACKAGE / files[-1]).read_text(encoding="utf-8")


def test_walks_name_existing_functions(sources: dict[Path, SourceFile]) -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"(?m)^\| \d+ ?•? \| `([\w/]+\.py)` \| (`[^|]*`) \|", text)
    assert len(rows) > 35
    missing = [
        (file, name)
        for file, names in rows
        for name in re.findall(r"`(\w+)`", names)
        if name not in {node.name for node in list_definitions(sources[PACKAGE / file].tree.body)}
    ]
    assert missing == []


def test_commands_contain_no_computation(sources: dict[Path, SourceFile]) -> None:
    """Commands load, call and write; longer files are listed with a reason."""
    folder = PACKAGE / "commands"
    lines = {p.relative_to(folder).as_posix(): count_code_lines(s) for p, s in sources.items() if folder in p.parents}
    assert len(lines) > 30
    assert {name for name, n in lines.items() if n > COMMAND_LINES} == set(LONGER_COMMANDS)


def test_top_level_entries_are_the_agreed_ones() -> None:
    found = {p.name for p in ROOT.iterdir() if not p.name.startswith(".") and not p.name.endswith(".egg-info")}
    assert found - MADE <= TOP_LEVEL


def test_long_files_state_a_reason(sources: dict[Path, SourceFile]) -> None:
    lines = {path.relative_to(PACKAGE).as_posix(): count_code_lines(source) for path, source in sources.items()}
    long = {name for name, n in lines.items() if n > MOST_LINES}
    assert long == set(LONGER)


def test_no_module_for_miscellaneous_functions() -> None:
    names = {p.relative_to(PACKAGE).as_posix() for p in PACKAGE.rglob("*")}
    assert not {n for n in names if Path(n).stem in ("utils", "helpers", "core", "common", "misc")}


@pytest.mark.parametrize("module", ["machopt", "machopt.cli", "machopt.options.plan_option_reader"])
def test_startup_imports_nothing_heavy(module: str) -> None:
    """`machopt --help` answers within half a second because these packages are imported late."""
    code = f"import {module}, sys; print(*({{m.partition('.')[0] for m in sys.modules}} & set({HEAVY})))"
    assert python(code).split() == []


def test_no_temporary_files_in_the_repository() -> None:
    """No temporary files of an editor, a merge or a patch in the repository or in the packages built from it."""
    left = (".orig", ".rej", ".bak", ".tmp", ".swp", "~")
    places = [PACKAGE, *(ROOT / name for name in ("tests", "docs", "cells", "toolpaths", "benchmarks"))]
    found = [p for place in places for p in place.rglob("*") if p.name.endswith(left) or " (copy)" in p.name]
    found += [p for p in ROOT.iterdir() if p.name.endswith(left)]
    assert not found
    packed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
    # so the wheel contains the files of the package folder
    assert packed["targets"]["wheel"]["packages"] == ["machopt"]


def test_float_array_type_has_one_definition() -> None:
    """``machopt.numerics.array_types`` defines it; other files must not define a second alias."""
    again = [
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if path != PACKAGE / "numerics" / "array_types.py"
        and re.search(r"^\w+ = NDArray\[np\.float64\]$", path.read_text(), re.MULTILINE)
    ]
    assert again == []


def test_ambiguous_class_names_are_unique() -> None:
    """Each of these names has only one class; other classes need a more specific name."""
    nouns = "Finding|Problem|Unknown|Model|Arm|Fit|Request|Outcome"
    found = [
        (noun, path.relative_to(ROOT).as_posix())
        for path in PACKAGE.rglob("*.py")
        for noun in re.findall(rf"(?m)^class ({nouns})\b", path.read_text(encoding="utf-8"))
    ]
    assert sorted(noun for noun, _ in found) == sorted({noun for noun, _ in found}), found


def test_stiffness_model_does_not_check_term_types() -> None:
    """Terms are used through their methods; a check of the class would have to be extended for each new family."""
    packages = ("kinematics", "collision", "dynamics", "stiffness")
    model = [f for package in packages for f in (PACKAGE / package).rglob("*.py")]
    assert len(model) > 40
    values = [f.name for f in model if re.search(r"\bis(instance|subclass)\(", f.read_text("utf-8"))]
    assert values == []


def test_classes_with_more_than_five_fields_are_keyword_only(sources: dict[Path, SourceFile]) -> None:
    """A call with more than five positional values is hard to read."""
    found = []
    for path, source in sources.items():
        for node in list_definitions(source.tree.body):
            if not isinstance(node, ast.ClassDef):
                continue
            message = [t for t in map(ast.unparse, node.decorator_list) if t.startswith("dataclass")]
            fields = [
                n for n in node.body if isinstance(n, ast.AnnAssign) and "ClassVar" not in ast.unparse(n.annotation)
            ]
            marked = any(ast.unparse(n.annotation) == "KW_ONLY" for n in fields)
            if message and len(fields) > 5 and not marked and "kw_only=True" not in message[0]:
                found.append(f"{path.relative_to(ROOT)}: {node.name}")
    assert found == []


def test_every_function_and_class_is_used(sources: dict[Path, SourceFile]) -> None:
    """Every function or class of the package is used elsewhere in it; helpers of tests only are in tests/."""
    named = Counter(word for source in sources.values() for word in re.findall(r"[A-Za-z_]\w*", source.text))
    found = []
    for path, source in sources.items():
        lines = source.text.splitlines()
        for node in source.tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                own = "\n".join(lines[node.lineno - 1 : node.end_lineno])
                if named[node.name] <= len(re.findall(rf"\b{node.name}\b", own)):
                    found.append(f"{path.relative_to(ROOT)}: {node.name}")
    assert found == []
