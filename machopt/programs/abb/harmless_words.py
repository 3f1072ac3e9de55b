"""ABB RAPID statements that cannot move points or frames, with the reason."""

from __future__ import annotations

from machopt.programs.reading.harmless_word_reasons import CHECKS, LOAD, NUMBER, SPEED, TEXT

RAPID: dict[str, str] = {
    **dict.fromkeys(("CONFL", "CONFJ"), "whether the robot checks its configuration; targets stay"),
    **dict.fromkeys(("SINGAREA", "CIRPATHMODE"), "the way of the wrist between two targets; the targets stay"),
    **dict.fromkeys(("ACCSET", "VELSET", "PATHACCLIM", "WORLDACCLIM"), SPEED),
    **dict.fromkeys(("ACTUNIT", "DEACTUNIT"), "which further mechanical units are active"),
    **dict.fromkeys(
        ("SYNCMOVEON", "SYNCMOVEOFF", "WAITSYNCTASK", "WAITROB", "STARTMOVE", "STOPMOVE"), "when robots move, not where"
    ),
    **dict.fromkeys(("SOFTACT", "SOFTDEACT"), "stiffness of the servo control; targets stay"),
    **dict.fromkeys(("GRIPLOAD", "MECHUNITLOAD"), LOAD),
    **dict.fromkeys(
        ("IDISABLE", "IENABLE", "IWATCH", "ISLEEP", "IDELETE", "CONNECT", "ISIGNALDI", "ISIGNALDO", "ITIMER"),
        "interrupts: they act only when something happens",
    ),
    **dict.fromkeys(("TRIGGIO", "TRIGGEQUIP", "TRIGGINT"), "prepares an output for TriggL, which is refused"),
    "SPEEDREFRESH": "the override, which is read and refused unless it is 100 %",
    "TPREADNUM": "a number from the operator; targets that need it are refused",
    **dict.fromkeys(("TPERASE", "TPWRITE", "ERRWRITE", "OPEN", "CLOSE", "WRITE", "UIMSGBOX"), TEXT),
    "TPREADFK": "a number from the operator; targets that need it are refused",
    **dict.fromkeys(("EOFFSOFF", "PDISPOFF"), "ends a displacement; those that begin one are refused"),
    **dict.fromkeys(("CLKRESET", "CLKSTART", "CLKSTOP", "INCR", "DECR", "ADD", "CLEAR"), NUMBER),
    "MOTIONSUP": CHECKS,
}
