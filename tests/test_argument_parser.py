"""Command line parser: unknown words, common options, shell completion."""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from machopt.cli import _build_parser, main
from machopt.cli.argument_errors import list_commands, list_options
from machopt.cli.help_pages import PAGES, ArrangedParser
from machopt.cli.shell_completion import build_completion_script

CELLS = Path(__file__).resolve().parents[1] / "cells"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["optimise", "a"], "COMMAND: found 'optimise'; did you mean 'optimize'?"),
        (["optimize", "a", "b", "-o", "c", "--alow-gaps"], "--alow-gaps; did you mean --allow-gaps? (machopt optimize"),
        (["map", "c", "-o", "d", "--collision", "cel"], "--collision: found 'cel'; did you mean 'cell'?"),
        (["validate", "a", "--toolpath", "b"], "not understood: --toolpath (an option of plan-poses"),
        (["inspect", "a", "b"], "not understood: b (machopt inspect"),
    ],
)
def test_mistyped_word_is_answered_with_the_nearest(
    words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shell_completion_covers_every_command_and_option(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    assert text == build_completion_script(shell, list_commands(_build_parser()))
    for word in ("optimize", "plan-poses", "validate", "map-collisions"):
        assert word in text
    if shell == "zsh":  # a minimal .zshrc, as on macOS, does not initialize completion
        assert text.startswith("(( $+functions[compdef] )) || { autoload -Uz compinit && compinit; }\n")
    if shell == "fish":
        assert "'__fish_seen_subcommand_from optimize' -l unit -x -a 'mm inch'\n" in text
        assert "'__fish_seen_subcommand_from optimize' -l plan -r\n" in text
        assert "'__fish_seen_subcommand_from optimize' -l allow-gaps\n" in text


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is absent")
@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("optimize --map", "--map-collisions"),
        ("optimize --post ra", "rapid"),
        ("optimize --unit ''", "mm inch"),
        ("completion ''", "bash zsh fish"),
        ("optimize ''", ""),  # file names, completed by the shell
        ("optimize --plan ''", ""),
        ("opt", "optimize"),
    ],
)
def test_bash_completes_commands_options_and_values(words: str, found: str) -> None:
    requested = f'COMP_WORDS=(machopt {words}); COMP_CWORD={len(words.split())}; _machopt; echo "${{COMPREPLY[@]}}"'
    text = build_completion_script("bash", list_commands(_build_parser()))
    done = subprocess.run(
        ["bash", "-c", f"{text}\n{requested}"], capture_output=True, text=True, check=True, timeout=20
    )
    assert done.stdout == f"{found}\n"


def test_every_command_accepts_the_common_options_of_the_contract() -> None:
    commands = {name: parser for name, parser in list_commands(_build_parser()).items() if name != "completion"}
    common = {"--seed", "--jobs", "--quiet", "--json", "--set", "--debug"}
    assert {name: common - set(list_options(parser)) for name, parser in commands.items()} == {
        n: set() for n in commands
    }
    assert len(commands) == 13


def _list_shown_options(page: str) -> list[str]:
    """Return the long options that have their own line on a help page."""
    return re.findall(r"(?m)^  (?:-\w(?: \S+)?, )?(--[\w-]+)", page)


@pytest.mark.parametrize("name", sorted(PAGES))
def test_help_shows_main_options_and_the_advanced_page_the_others(name: str) -> None:
    parser = list_commands(_build_parser())[name]
    assert isinstance(parser, ArrangedParser)
    first, second = _list_shown_options(parser.format_help()), _list_shown_options(parser.format_advanced_help())
    offered = {a.option_strings[-1] for a in parser._actions if a.option_strings and a.help != argparse.SUPPRESS}
    assert sorted(first + second) == sorted(offered - {"--help-advanced"})
    assert len(first) <= 20
    assert {option for _, options in PAGES[name].groups for option in options} <= set(first)
    (example,) = re.findall(r"(?m)^example:\n  (.*)$", parser.format_help())
    assert _build_parser().parse_args(shlex.split(example)[1:]).command == name


@pytest.mark.parametrize("page", ["--help", "--help-advanced"])
def test_help_is_printed_without_further_arguments(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["optimize", page])
    assert end.value.code == 0
    assert "machopt optimize" in capsys.readouterr().out


def test_options_without_effect_are_hidden() -> None:
    """They are accepted because scripts pass them to every command; help and completion do not show them."""
    parsers = list_commands(_build_parser())
    offered = {name: p.format_help() + p.format_advanced_help() for name, p in parsers.items() if name in PAGES}
    assert {name for name, text in offered.items() if "--jobs" in text} == {"batch", "place"}
    assert "--seed" not in offered["validate"]
    assert "--seed" in offered["identify"]
    assert "--set" not in offered["init"]


def test_unused_planning_options_are_validated_and_reported(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["validate", str(CELLS / "kr500_milling"), "--seed", "3", "--jobs", "2", "--set"]
    assert main([*words, "clearance_mm=3"]) == 0
    assert capsys.readouterr().err == "machopt: --set clearance_mm=3 has no effect: validate plans nothing\n"
    assert main([*words, "clearance_mm=3", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert main([*words, "clearence_mm=3"]) == 2
    assert "did you mean 'clearance_mm'" in capsys.readouterr().err


def test_unused_planning_options_of_a_diagnosis_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    typed = ["diagnose", str(CELLS / "kr500_milling"), str(tmp_path / "none"), "-o", str(tmp_path / "out")]
    assert main([*typed, "--set", "seed=3"]) == 2
    assert "--set seed=3 has no effect: nothing is planned without --toolpath\n" in capsys.readouterr().err


REPEATED = {  # words of map, and whether they contradict each other
    "bare steps": (["--step", "5000", "--step", "900"], True),
    "bare steps of one value": (["--step", "5000", "--step", "5e3"], False),
    "a bare step and one of an axis": (["--step", "5000", "--step", "x=900"], False),
    "steps of two axes": (["--step", "x=5", "--step", "y=9"], False),
    "steps of one axis": (["--step", "x=5", "--step", "x=9"], True),
    "an empty name": (["--step", "=5", "--step", "9"], True),
    "a number in two notations": (["--set", "rotation_step_deg=5", "--set", "rotation_step_deg=5.0"], False),
    "two numbers": (["--set", "rotation_step_deg=5", "--set", "rotation_step_deg=5.01"], True),
    "a list in two notations": (["--set", "band_deg=[0, 10]", "--set", "band_deg=[0.0,1e1]"], False),
    "two lists": (["--set", "band_deg=[0, 10]", "--set", "band_deg=[0, 11]"], True),
    "a list and its first number": (["--set", "a=1", "--set", "a=[1]"], True),
    "two words": (["--set", "method=a", "--set", "method=b"], True),
    "a range in two notations": (["--range", "x=0:10", "--range", "x=0.:10.0"], False),
    "two ranges": (["--range", "x=0:10", "--range", "x=0:100"], True),
}


@pytest.mark.parametrize("name", REPEATED)
def test_repeated_option_with_another_value_is_refused(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    words, contradicts = REPEATED[name]
    command = ["map", "cell", "-o", "out", *words]
    if not contradicts:
        assert _build_parser().parse_args(command).command == "map"
        return
    with pytest.raises(SystemExit) as end:
        _build_parser().parse_args(command)
    assert end.value.code == 2
    assert words[0] in capsys.readouterr().err
