"""README and the pages it links to: short, valid links, commands that run in order."""

from __future__ import annotations

import csv
import re
import shlex
import shutil
import textwrap
from pathlib import Path

import pytest
from independent_poses_reader import read_poses_csv
from small_cell import urdf_text

import machopt
from machopt import Cell, Plan, Toolpath
from machopt.cli import _build_parser, main

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "docs" / "install" / "README.md"]
MOST_LINES = 300
PART = """TOOL PATH/DECK,TOOL,MILL
UNITS/MM
LOADTL/1
FROM/0,0,60,0,0,1
RAPID
GOTO/0,0,20
FEDRAT/MMPM,600
GOTO/0,0,-1
GOTO/40,0,-1
GOTO/40,30,-1
RAPID
GOTO/40,30,60
END-OF-PATH
FINI
"""


def test_readme_is_short_and_its_links_exist() -> None:
    assert len(README.splitlines()) <= MOST_LINES
    missing = [
        f"{page.relative_to(ROOT)}: {to}"
        for page in PAGES
        for to in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
        if not to.startswith(("http:", "https:")) and not (page.parent / to).exists()
    ]
    assert missing == []
    unlinked = {p.name for p in (ROOT / "docs").glob("*.md")} - set(re.findall(r"docs/([\w-]+\.md)", README))
    assert unlinked == set()


def test_every_documented_command_parses() -> None:
    """The parser accepts all options and commands; other tests cover what the commands do."""
    parser, refused = _build_parser(), []
    for page in PAGES:
        for line in commands(page.read_text(encoding="utf-8")):
            try:
                parser.parse_args(shlex.split(line)[1:])
            except (SystemExit, ValueError) as why:
                refused.append(f"{page.name}: {line}: {why}")
    assert refused == []


PROCESS = """machopt_process: 1
operations:
  default: {kind: force, force_N: {normal: 200, axial: 100}, spread_percent: 20, tolerance: {surface_mm: 1}}
"""


@pytest.mark.slow
def test_commands_run_in_their_documented_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The arm and the part are typical of a new user's; ``view`` waits for a browser and has its own tests."""
    monkeypatch.chdir(tmp_path)
    Path("robot.urdf").write_text(urdf_text(), encoding="utf-8")
    Path("part.cls").write_text(PART, encoding="utf-8")
    Path("process.yaml").write_text(PROCESS, encoding="utf-8")
    Path("out").mkdir()
    ended = {}
    for line in commands(README, "machopt|cp"):
        words = shlex.split(line)
        if words[:2] == ["machopt", "view"]:
            continue
        if words[0] == "cp":
            shutil.copy(words[1], words[2])
            continue
        if words[1] == "identify":
            fill_in(Path("out/plan"))
        ended[line] = main([*words[1:], "--quiet"])
    assert len(ended) > 10
    assert {line: code for line, code in ended.items() if code} == {}
    for file in ("mycell.svg", "out/part/report.html", "out/front/front.csv", "out/posts/rapid", "out/diagnosis"):
        assert Path(file).exists(), file


@pytest.mark.slow
def test_library_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("robot.urdf").write_text(urdf_text(), encoding="utf-8")
    Path("part.cls").write_text(PART, encoding="utf-8")
    Cell.new("robot.urdf", "mycell", toolpath="part.cls")
    code = re.search(r"```python\n(import machopt\n.*?)```", README, re.S)
    assert code is not None
    names: dict[str, object] = {}
    exec(compile(code.group(1), "README.md", "exec"), names)
    assert isinstance(names["plan"], Plan)
    assert isinstance(names["path"], Toolpath)
    assert Path("map.svg").stat().st_size > 1000
    assert Path("out/part/report.html").is_file()
    shutil.rmtree("out/part")
    example = re.search(r"As a library.*?::\n\n(.*?)\n\S", machopt.__doc__ or "", re.S)
    assert example is not None
    at_cell = textwrap.dedent(example.group(1)).replace("cells/kr500_milling", "mycell")
    exec(compile(at_cell, "machopt.__doc__", "exec"), {})
    assert Path("out/part/report.html").is_file()


def commands(page: str, begins: str = "machopt") -> list[str]:
    """Return the command lines of a page's shell blocks, without trailing comments."""
    blocks = re.findall(r"```(?:sh|bash)?\n(.*?)```", page, re.S)
    lines = [line.split("  #")[0].strip() for block in blocks for line in block.splitlines()]
    return [line for line in lines if re.match(rf"(?:{begins}) ", line)]


def fill_in(plan: Path) -> None:
    """Write the displacements that the model predicts for the loads into the empty recording."""
    moved = read_poses_csv(plan / "poses.csv").displacement  # m
    file = plan / "recording_template" / "data.csv"
    with file.open(newline="", encoding="utf-8") as text:
        header, *rows = csv.reader(text)
    columns = [header.index(c) for c in ("dx_mm", "dy_mm", "dz_mm")]
    for row, d in zip(rows, moved, strict=True):
        for c, value in zip(columns, d[:3], strict=True):
            row[c] = repr(1e3 * float(value))
    with file.open("w", newline="", encoding="utf-8") as out:
        csv.writer(out).writerows([header, *rows])
