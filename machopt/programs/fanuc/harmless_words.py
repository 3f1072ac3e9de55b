"""FANUC statements that cannot move points or frames, with the reason. They are identified by their beginning."""

from __future__ import annotations

from machopt.programs.reading.harmless_word_reasons import CHECKS, LOAD, NUMBER, OUTPUT, SPEED, TEXT

FANUC: dict[str, str] = {
    "PAYLOAD": LOAD,
    "TOOL_OFFSET CONDITION": "names the register of a shift; moves that use it are refused",
    "OFFSET CONDITION": "names the register of a shift; moves that use it are refused",
    **dict.fromkeys(("JOINT_MAX_SPEED", "LINEAR_MAX_SPEED"), SPEED),
    **dict.fromkeys(("COL DETECT", "COL GUARD"), CHECKS),
    **dict.fromkeys(("ERROR_PROG", "RESUME_PROG"), "which program runs after a fault"),
    **dict.fromkeys(("TIMER", "R[", "SR[", "F["), NUMBER),
    "PR[": "a position register; moves to it or by it are refused",
    **dict.fromkeys(("MESSAGE", "REMARK", "UALM"), TEXT),
    "RSR": "requests to start a program",
    **dict.fromkeys(("LOCK", "UNLOCK"), "whether the controller reads position registers ahead"),
    "MONITOR": CHECKS,
    **dict.fromkeys(("GO[", "AO["), OUTPUT),
    "POINT_LOGIC": OUTPUT,
    "PALLETIZING": "moves to a pallet's positions are refused",
    **dict.fromkeys(("$WAITTMOUT", "$TIMER", "$SPEED", "$SHELL_WRK.$CUST_START"), NUMBER),
    "TC_ONLINE": "torch angle control off or on; it changes no taught position",
    "-": "a heading",
}
