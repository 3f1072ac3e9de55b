"""Single-value options: a repetition with another value is refused by every command."""

from __future__ import annotations

import argparse

import pytest

from machopt.cli import _build_parser
from machopt.cli.argument_errors import NamedValuesAction, SingleValueAction, list_commands

EXAMPLES = {
    float: ("1.5", "2.5"),
    int: ("3", "4"),
    None: ("A", "B"),
}
PARSER = _build_parser()


def list_single_valued() -> list[tuple[str, argparse.Action]]:
    found = []
    for name, command in list_commands(PARSER).items():
        for action in command._actions:
            if isinstance(action, SingleValueAction) and action.option_strings:
                found.append((name, action))
    return found


def choose_values(action: argparse.Action) -> tuple[list[str], list[str]] | None:
    """Return two different accepted values; None where a number or a specific word is expected."""
    count = action.nargs if isinstance(action.nargs, int) else 1
    if action.choices is not None:
        if len(list(action.choices)) < 2:
            return None
        first, second = (str(c) for c in list(action.choices)[:2])
        return [first] * count, [second] * count
    for pair in (("1", "2"), ("1.5", "2.5"), ("0", "45"), ("1,2,3,4,5,6", "2,2,3,4,5,6"), ("A", "B")):
        try:
            values = [action.type(text) if callable(action.type) else text for text in pair]
        except (ValueError, TypeError, argparse.ArgumentTypeError):
            continue
        if values[0] != values[1]:
            return [pair[0]] * count, [pair[1]] * count
    return None


def test_every_command_refuses_repeated_options() -> None:
    actions = list_single_valued()
    assert len({name for name, _ in actions}) >= 12
    for name, command in list_commands(PARSER).items():
        for action in command._actions:
            assert type(action) not in (argparse._StoreAction, argparse._AppendAction), (name, action.option_strings)


@pytest.mark.parametrize(
    ("command", "action"), list_single_valued(), ids=[f"{n} {a.option_strings[-1]}" for n, a in list_single_valued()]
)
def test_contradicting_repetition_is_refused(
    command: str, action: argparse.Action, capsys: pytest.CaptureFixture[str]
) -> None:
    pair = choose_values(action)
    if pair is None:
        assert action.type is not None
        return
    option = action.option_strings[-1]
    with pytest.raises(SystemExit) as stopped:
        list_commands(PARSER)[command].parse_known_args([option, *pair[0], option, *pair[1]])
    assert stopped.value.code == 2
    assert option in capsys.readouterr().err


def parse(*words: str) -> argparse.Namespace:
    return _build_parser().parse_args(["optimize", "cell", "path", "-o", "out", *words])


def test_same_value_may_be_repeated() -> None:
    assert parse("--unit", "mm", "--unit", "mm").unit == "mm"
    assert parse("--unit=mm").unit == "mm"
    assert parse("--unit", "inch").unit == "inch"  # another run of the same parser


@pytest.mark.parametrize(
    "words",
    [
        ("--set", "weights.travel=0", "--set", "weights.travel=1"),
        ("--offset", "G55=1,2,3", "--offset", "G55=1,2,4"),
        ("--set=seed=1", "--set", "seed = 2"),
        ("-o", "other"),
    ],
)
def test_name_with_two_values_is_refused(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        parse(*words)
    assert stopped.value.code == 2
    assert "given twice" in capsys.readouterr().err


def test_options_that_may_be_repeated() -> None:
    found = parse("--set", "a=1", "--set", "b=2", "--set", "a=1", "--accept-unknown", "X", "--accept-unknown", "Y")
    assert found.set == ["a=1", "b=2", "a=1"]
    assert found.accept_unknown == ["X", "Y"]
    assert isinstance(next(a for a in list_commands(PARSER)["optimize"]._actions if a.dest == "set"), NamedValuesAction)
