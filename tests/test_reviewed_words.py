"""Ignored words are on the reviewed list; options named in messages exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import machopt
from machopt.cell.cell_schema import CutterKeys
from machopt.cli import main
from machopt.options.option_schema import OptionKeys
from machopt.toolpath.readers import harmless_words

PACKAGE = Path(machopt.__file__).parent
READERS = PACKAGE / "toolpath" / "readers"
READING_PARTS = (  # readers of every input file
    "cell",
    "file_formats",
    "input_files",
    "measurement/recording",
    "options",
    "output/tables",
    "path_building",
    "programs",
    "toolpath",
)
MESSAGES = {  # modules with messages of the toolpath readers, including shared ones
    "toolpath": "**/*.py",
    "path_building": "**/*.py",
    "file_formats": "*.py",
    "cell": "*.py",
    "cell/joints": "*.py",
    "cell/stiffness": "*.py",
    "input_files": "*.py",
    "options": "*.py",
    "output/tables": "*.py",
}
TABLES = {name for name in vars(harmless_words) if name.isupper() and not name.startswith("_")}
READING = {"inspect", "optimize", "verify", "batch"}
ELSEWHERE = {
    "--cell": {"inspect", "batch"},
    "--set": {"optimize", "verify", "batch"},
    "--plan": {"optimize", "verify", "batch"},
    "--allow-external": READING,
    "--fit": {"identify"},
    "--compensate": {"optimize"},
    "--tables": {"optimize", "identify", "process", "diagnose", "map", "plan-poses", "place", "batch"},
}


def _list_ignored_calls(tree: ast.AST) -> list[ast.Call]:
    return [
        n
        for n in ast.walk(tree)
        if isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute) and n.func.attr == "ignore"
    ]


def test_every_ignored_word_is_reviewed() -> None:
    """Each word with ``understood=True`` in a reader, or its beginning, has a reason in the list."""
    known = [*harmless_words.CARRIED_OUT, *harmless_words.APT, *harmless_words.HEIDENHAIN]
    known += [f"CYCL DEF {n}" for n in harmless_words.HEIDENHAIN_CYCLES]
    missing = []
    # columns: see unknown_columns.py
    for file in sorted(f for f in READERS.rglob("*.py") if f.parent.name != "tables"):
        for call in _list_ignored_calls(ast.parse(file.read_text(encoding="utf-8"))):
            flag = next(k.value for k in call.keywords if k.arg == "understood")
            word = call.args[0]
            if not (isinstance(flag, ast.Constant) and flag.value is True and isinstance(word, ast.Constant)):
                continue
            if not any(str(word.value) == k or str(word.value).startswith(k) for k in known):
                missing.append((file.name, word.value))
    assert not missing


def test_every_review_has_a_reason() -> None:
    for table in TABLES:
        for word, reason in getattr(harmless_words, table).items():
            assert len(str(reason)) > 5, (table, word)


@pytest.mark.parametrize("word", [450, 460, 121, 71, 160, 510, 511, 290, 310])
def test_motion_words_are_not_on_the_list(word: int) -> None:
    assert word not in harmless_words.G


def _help(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    for page in ("--help", "--help-advanced"):
        with pytest.raises(SystemExit):
            main([command, page])
    return capsys.readouterr().out


def test_every_option_named_by_a_reader_parses(capsys: pytest.CaptureFixture[str]) -> None:
    """In every text of the readers that names an option: the commands that read toolpaths accept it."""
    named: dict[str, str] = {}
    for file in (f for part, names in MESSAGES.items() for f in (PACKAGE / part).glob(names)):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", node.value):
                    named.setdefault(option, file.name)
    assert {"--unit", "--feed", "--machine", "--offset", "--decimals"} <= named.keys()
    helps = {
        command: _help(command, capsys) for command in {*READING, *(c for some in ELSEWHERE.values() for c in some)}
    }
    wrong = [
        (option, file, command)
        for option, file in named.items()
        for command in ELSEWHERE.get(option, READING)
        if not re.search(rf"{option}(?![\w-])", helps[command])
    ]
    assert not wrong


COMMANDS = (
    "optimize",
    "identify",
    "process",
    "diagnose",
    "plan-poses",
    "map",
    "inspect",
    "verify",
    "batch",
    "place",
    "init",
    "validate",
    "view",
)
PARTS = {  # packages → commands whose messages they write
    "readers": (READING_PARTS, COMMANDS),
    "cli": (("cli",), COMMANDS),
    "commands": (("commands",), COMMANDS),
    "program_export": (("program_export",), COMMANDS),
    "verification": (("verification",), COMMANDS),
    "planning": (("planning",), ("optimize", "verify", "batch")),
}
SMALL = ("program_export", "verification")  # with a single option each
OPTION_WORD = re.compile(r"(?<![\w-])--[a-z][A-Za-z-]*[A-Za-z]")


def _texts(*packages: str) -> list[tuple[str, str]]:
    """Return the strings of packages with their file."""
    out = []
    for file in sorted(f for package in packages for f in (PACKAGE / package).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                out.append((file.relative_to(PACKAGE).as_posix(), node.value))
    return out


@pytest.mark.parametrize("part", PARTS)
def test_every_option_named_in_a_message_exists(part: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Formats, commands, jobs and plan: at least one of the commands of a message accepts the named option."""
    packages, commands = PARTS[part]
    assert all((PACKAGE / package).is_dir() for package in packages)
    helps = "\n".join(_help(command, capsys) for command in commands)
    known = {*OPTION_WORD.findall(helps), "--version", "--terms"}  # the last is an alias that no help text shows
    named = {(option, file) for file, text in _texts(*packages) for option in OPTION_WORD.findall(text)}
    assert len(named) > (0 if part in SMALL else 3)
    assert not {(option, file) for option, file in named if option not in known}


def test_every_planning_key_named_in_a_message_exists() -> None:
    """Keys of ``--set`` and of the tool's cutter in the texts with remedies."""
    keys = {*OptionKeys.model_fields, *CutterKeys.model_fields}
    ending = re.compile(r"\b[a-z]+(?:_[a-z]+)*_(?:deg|mm|ms)\b")
    named = {
        word
        for file, text in _texts("planning")
        if file
        in (
            "planning/plan_output/infeasibility_reasons.py",
            "planning/plan_output/infeasibility_remedies.py",
            "planning/plan_output/plan_remarks.py",
            "planning/pipeline/sequence_breaks.py",
            "planning/pipeline/gaps.py",
        )
        for word in ending.findall(text)
    }
    assert named
    assert named <= keys
