"""Checks of Stäubli programs: configuration words of points."""

from __future__ import annotations

from machopt.programs.checking.program_checks import ArmPosture, ProgramChecks, Words


def _compare_words(program_words: Words, posture: ArmPosture) -> list[bool]:
    if "wrist" not in program_words:
        return []
    out = [
        (program_words["wrist"] == "wnegative") in posture.is_negative[4],
        (program_words.get("elbow") == "enegative") in posture.is_negative[2],
    ]
    if posture.wrist_behind is not None:
        out.append(program_words.get("shoulder") == ("righty" if posture.wrist_behind else "lefty"))
    return out


CHECKS = ProgramChecks(compare_words=_compare_words)
