"""Checks of ABB programs: confdata of robtargets."""

from __future__ import annotations

from machopt.programs.checking.program_checks import ArmPosture, ProgramChecks, Words, read_whole_number


def _compare_words(program_words: Words, posture: ArmPosture) -> list[bool]:
    if "cf1" not in program_words:
        return []
    axes = (("cf1", 0), ("cf4", 3), ("cf6", 5))
    out = [program_words[name] in {posture.low[k] // 90.0, posture.high[k] // 90.0} for name, k in axes]
    if posture.wrist_behind is not None:
        cfx = read_whole_number(program_words, "cfx")
        out += [bool(cfx & 4) == posture.wrist_behind, bool(cfx & 2) != posture.elbow_up]
        out.append(bool(cfx & 1) in posture.is_negative[4])
    return out


CHECKS = ProgramChecks(compare_words=_compare_words)
