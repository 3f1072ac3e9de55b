"""Suggestions for unknown words: typing errors only, no words with another meaning."""

from __future__ import annotations

import string

import pytest

from machopt.cli import main
from machopt.options.option_schema import OptionKeys
from machopt.spelling_suggestions import count_slips, find_typo

OPTIONS = list(OptionKeys.model_fields)


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("rotation_stp_deg", "rotation_step_deg"),
        ("rotation_steps_deg", "rotation_step_deg"),
        ("rotation_step", "rotation_step_deg"),
        ("rotatoin_step_deg", "rotation_step_deg"),
        ("Rotation-Step-Deg", "rotation_step_deg"),
        ("clearence_mm", "clearance_mm"),
        ("clearance", "clearance_mm"),
        ("clearancemm", "clearance_mm"),
        ("allow-gaps", "allow_gaps"),
        ("alow_gaps", "allow_gaps"),
        ("metod", "method"),
        ("colision", "collision"),
        ("wieghts", "weights"),
    ],
)
def test_typing_errors_are_answered_with_the_word(word: str, meant: str) -> None:
    assert find_typo(word, OPTIONS) == meant


@pytest.mark.parametrize(
    ("word", "valid"),
    [
        ("force", ["force_travel", "face"]),
        ("clearance_m", ["clearance_mm"]),
        ("rotation_step_rad", ["rotation_step_deg"]),
        ("velocity_mm_s", ["velocity_deg_s"]),
        ("q1_deg", ["q7_deg", "q2_deg"]),
        ("link_6", ["link_7"]),
        ("e1", ["e2"]),
        ("min_kci", ["max_kci"]),
        ("least", ["most"]),
        ("lower_mm", ["upper_mm"]),
        ("first_point", ["last_point"]),
        ("tool_axis", ["tool_mass"]),
        ("post", ["port", "pose"]),
        ("sample_s", ["sample_ms"]),
        ("load_axes", ["load"]),
        ("tcp", ["tip"]),
        ("axial", ["normal"]),
        ("verbose", ["verify"]),
        ("output", ["input"]),
        ("x_mm", ["y_mm", "z_mm"]),
    ],
)
def test_words_of_another_meaning_are_not_suggested(word: str, valid: list[str]) -> None:
    assert find_typo(word, valid) is None


@pytest.mark.parametrize("option", OPTIONS)
def test_every_single_typing_error_of_an_option_finds_it(option: str) -> None:
    head, letters = option.split("_", maxsplit=1)[0], string.ascii_lowercase
    if len(head) >= 5:
        for at in range(1, len(head) - 1):
            for slip in (head[:at] + head[at + 1 :], head[:at] + letters[at] + head[at:]):
                found = find_typo(slip + option[len(head) :], OPTIONS)
                assert found == option or (found is not None and count_slips(found, slip) <= 1)
    if option.endswith("_mm"):
        assert find_typo(option.removesuffix("mm") + "m", [option]) is None


@pytest.mark.parametrize(
    ("words", "says", "not_said"),
    [
        (["optimize", "a", "b", "-o", "c", "--alow-gaps"], "did you mean --allow-gaps?", ""),
        (["optimize", "a", "b", "-o", "c", "--compensat"], "did you mean --compensate?", ""),
        (["optimize", "a", "b", "-o", "c", "--samplems", "5"], "did you mean --sample-ms?", ""),
        (["optimize", "a", "b", "-o", "c", "--collision"], "--collision (an option of map)", "mean"),
        (["verify", "a", "b", "c", "--post", "krl"], "--post (an option of", "mean"),
        (["map", "c", "-o", "d", "--posts", "krl"], "--posts", "mean"),
        (["plan-poses", "c", "-o", "d", "--forcing"], "--forcing", "mean"),
        (["optimize", "a", "b", "-o", "c", "--verbose"], "--verbose", "mean"),
        (["optimize", "a", "b", "-o", "c", "--tolerance"], "--tolerance", "mean"),
        (["optimize", "a", "b", "-o", "c", "--speed", "5"], "--speed", "--sample"),
    ],
)
def test_unknown_options_of_commands(
    words: list[str], says: str, not_said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    output = capsys.readouterr().err
    assert ended.value.code == 2
    assert says in output
    assert not not_said or not_said not in output
