"""Yaskawa statements that cannot move points or frames, with the reason. They are identified by their beginning."""

from __future__ import annotations

from machopt.programs.reading.harmless_word_reasons import CHECKS, NUMBER, OUTPUT, TEXT

JBI: dict[str, str] = {
    **dict.fromkeys(("NOP", "END", "SFTOF"), "does nothing, or ends what is refused when it begins"),
    **dict.fromkeys(("MSG", "COMM"), TEXT),
    **dict.fromkeys(
        ("CLEAR", "SET", "INC", "DEC", "ADD", "SUB", "MUL", "DIV", "SETE", "GETE", "GETS", "CNVRT"),
        "variables; a change of a position that the job moves to is refused",
    ),
    "SETTOOL": "the dimensions of a tool; targets are those of its tip",
    "ARATION": NUMBER,
    "REFP": "reference points of weaving",
    **dict.fromkeys(("DIN", "AIN", "SETREG", "GETREG"), "reads inputs and registers into variables"),
    **dict.fromkeys(("NWAIT", "CWAIT", "ADVINIT", "ADVSTOP"), "how far the controller reads ahead"),
    **dict.fromkeys(("SHCKSET", "SHCKRST"), CHECKS),
    **dict.fromkeys(("HAND", "CLS"), OUTPUT),
}
