"""Checks of KUKA programs: S and T of targets."""

from __future__ import annotations

from collections.abc import Sequence

from machopt.programs.checking.program_checks import ArmPosture, ProgramChecks, Words


def _compare_words(program_words: Words, posture: ArmPosture) -> list[bool]:
    out: list[bool] = []
    turn, status = program_words.get("T"), program_words.get("S")
    if isinstance(turn, int):
        out += [bool(turn >> k & 1) in posture.is_negative[k] for k in range(6)]
    if isinstance(status, int) and posture.wrist_behind is not None:
        out += [bool(status & 1) == posture.wrist_behind, bool(status & 2) == posture.elbow_up]
        out.append(bool(status & 4) in posture.is_negative[4])
    return out


def _list_percents(words: Sequence[Words]) -> list[float]:
    stated = (w.get("cptp") for w in words)
    return [float(value) if isinstance(value, int | float) else float("nan") for value in stated]


CHECKS = ProgramChecks(
    compare_words=_compare_words,
    copy_printed_columns=lambda words: {"cptp": _list_percents(words)},
    list_rounded_shares=lambda words: [percent / 200.0 for percent in _list_percents(words)],
)
