"""VAL3 statements that cannot move points or frames, with the reason."""

from __future__ import annotations

from machopt.programs.reading.harmless_word_reasons import NUMBER, TEXT

VAL3: dict[str, str] = {
    **dict.fromkeys(
        (
            "waitEndMove",
            "resetMotion",
            "enablePower",
            "disablePower",
            "autoConnectMove",
            "restartMove",
            "stopMove",
            "isPowered",
        ),
        "when the robot moves, not where",
    ),
    **dict.fromkeys(("put", "putln", "logMsg", "popUpMsg", "cls", "userPage", "gotoxy", "title"), TEXT),
}

VAL3_TYPES: dict[str, str] = dict.fromkeys(("num", "bool", "string", "dio", "aio", "sio"), NUMBER)
