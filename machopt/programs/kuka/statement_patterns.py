"""Patterns of KRL statements: moves, declarations, and statements without motion inside a branch."""

from __future__ import annotations

import re

from machopt.programs.kuka.file_routines import OPENS, get_first_word
from machopt.programs.kuka.harmless_words import KRL_STATEMENTS

MOVE = re.compile(r"((?:S?(?:PTP|LIN|CIRC)|SPL)(?:_REL)?)\s*(?=[\s{])(.*)", re.IGNORECASE)
WITHOUT_EFFECT = re.compile(
    r"(?:INTERRUPT|GLOBAL\s+INTERRUPT|CONTINUE|INI|EXT|EXTFCT|ENDDAT|IMPORT|SIGNAL|STRUC|ENUM)\b", re.IGNORECASE
)
SWITCHES = re.compile(r"\bDO\s+(?:\$(?:OUT|ANOUT|CYCFLAG|FLAG)\b|PULSE\s*\()", re.IGNORECASE)  # at a place of the path
TYPES = frozenset(  # words that a declaration begins with; a type of one's own needs DECL
    (
        "DECL",
        "GLOBAL",
        "CONST",
        "INT",
        "REAL",
        "BOOL",
        "CHAR",
        "FRAME",
        "POS",
        "E3POS",
        "E6POS",
        "AXIS",
        "E3AXIS",
        "E6AXIS",
        "LOAD",
        "FDAT",
        "PDAT",
        "LDAT",
    )
)
_WITHIN = (
    "ELSE",
    "CASE",
    "DEFAULT",
    "HALT",
    "WAIT",
    "RETURN",
    "EXIT",
    "GOTO",
    "RESUME",
    "SPLINE",
    "ENDSPLINE",
    "PULSE",
)


def is_harmless_statement(code: str) -> bool:
    """Return whether a statement in a branch neither moves nor assigns, or is covered by another check.

    Args:
        code: The statement in upper case.
    """
    word = get_first_word(code)
    known = (*OPENS, *OPENS.values(), *_WITHIN, *KRL_STATEMENTS, *TYPES)
    switches = word == "TRIGGER" and SWITCHES.search(code) is not None
    return word in known or switches or code.endswith(":") or bool(WITHOUT_EFFECT.match(code) or MOVE.fullmatch(code))
