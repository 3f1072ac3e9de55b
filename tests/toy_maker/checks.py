"""Checks of toy programs: the side of the wrist."""

from __future__ import annotations

from machopt.programs.checking.program_checks import ArmPosture, ProgramChecks, Words


def _compare_words(said: Words, posture: ArmPosture) -> list[bool]:
    return [(said["wrist"] == "down") in posture.is_negative[4]] if "wrist" in said else []


CHECKS = ProgramChecks(compare_words=_compare_words)
