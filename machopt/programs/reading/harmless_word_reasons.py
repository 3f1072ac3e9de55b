"""Reasons why statements of robot programs cannot move points; each maker's ``harmless_words.py`` lists statements.

A statement that is neither listed nor executed by the reader stops a plan (:mod:`machopt.toolpath.unknown_words`).
"""

from __future__ import annotations

import re

TEXT = "text for the operator, files or the network"
OUTPUT = "switches outputs; the motion is unchanged"
SPEED = "speed and acceleration within the controller's limits; points stay"
ROUNDING = "how closely the controller follows; the robot keeps its own tolerance"
PLANNING = "the controller's advance run and block coincidence"
NUMBER = "counters, flags and timers that no point depends on here"
LOAD = "mass and inertia that the controller plans with"
CHECKS = "collision detection and other monitoring"
READ_ONLY = "a copy of what is active, for the operator"


def compile_beginning_pattern(words: dict[str, str]) -> re.Pattern[str]:
    """Compile a pattern for statements that begin with one of the words; a word that ends with a letter ends there.

    Args:
        words: Word → reason why it cannot move anything.

    Returns:
        The pattern.
    """
    ordered = sorted(words, key=len, reverse=True)
    return re.compile("|".join(re.escape(w) + (r"(?![A-Z])" if w[-1].isalpha() else "") for w in ordered))
