"""What the command line says to words it does not know, and what a shell completes."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from machopt.cli import _parser, main
from machopt.cli.completion import script
from machopt.cli.parser import commands_of


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["optimise", "a"], "COMMAND: found 'optimise'; did you mean 'optimize'?"),
        (["optimize", "a", "b", "-o", "c", "--alow-gaps"], "--alow-gaps; did you mean --allow-gaps? (machopt optimize"),
        (["map", "c", "-o", "d", "--collision", "cel"], "--collision: found 'cel'; did you mean 'cell'?"),
        (["inspect", "a", "b"], "not understood: b (machopt inspect"),
    ],
)
def test_a_mistyped_word_is_answered_with_the_nearest(
    words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_completes_every_command_and_option(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    assert text == script(shell, commands_of(_parser()))
    for word in ("optimize", "plan-poses", "validate", "map-collisions"):
        assert word in text
    if shell == "bash" and shutil.which("bash"):
        asked = 'COMP_WORDS=(machopt optimize --map); COMP_CWORD=2; _machopt; echo "${COMPREPLY[@]}"'
        done = subprocess.run(
            ["bash", "-c", f"{text}\n{asked}"], capture_output=True, text=True, check=True, timeout=20
        )
        assert done.stdout == "--map-collisions\n"
