"""KUKA KRL statements that cannot move points or frames, with the reason."""

from __future__ import annotations

from machopt.programs.reading.harmless_word_reasons import (
    CHECKS,
    LOAD,
    NUMBER,
    OUTPUT,
    PLANNING,
    READ_ONLY,
    ROUNDING,
    SPEED,
    TEXT,
)

ORIENTATION_IGNORED = ("#CONSTANT", "#IGNORE")  # values of $ORI_TYPE: the orientations of the targets do not hold

KRL_VARIABLES: dict[str, str] = {
    **dict.fromkeys(("$ADVANCE", "$BWDSTART", "$STOPNOAPROX"), PLANNING),
    **dict.fromkeys(
        ("$ORI_TYPE", "$CIRC_TYPE", "$ORI_CHECK"),
        "the way between two orientations; at the points they are as programmed",
    ),
    **dict.fromkeys(("$APO", "$SPL_VEL_MODE", "$SPL_VEL_RESTR"), ROUNDING),
    **dict.fromkeys(
        (
            "$ACC",
            "$ACC_AXIS",
            "$VEL_AXIS",
            "$VEL",
            "$ACC_EXTAX",
            "$VEL_EXTAX",
            "$JERK",
            "$GEAR_JERK",
            "$ECO_LEVEL",
            "$ADAP_ACC",
        ),
        SPEED,
    ),
    **dict.fromkeys(("$LOAD", "$LOAD_A1", "$LOAD_A2", "$LOAD_A3"), LOAD),
    **dict.fromkeys(("$ACT_BASE", "$ACT_TOOL", "$ACT_EX_AX"), READ_ONLY),
    "$H_POS": "the place of the home position, which moves to it use",
    **dict.fromkeys(("$LOOP_MSG", "$LOOP_CONT", "$MSG_T", "$ERR"), TEXT),
    **dict.fromkeys(("$TIMER", "$TIMER_STOP", "$TIMER_FLAG"), NUMBER),
    **dict.fromkeys(("$TORQ_DIFF", "$TORQ_DIFF2", "$TORQMON", "$TORQMON_DEF", "$TORQMON_COM"), CHECKS),
    "$OUT_C": OUTPUT,
}

KRL_CALLS: dict[str, str] = {
    **dict.fromkeys(("CWRITE", "COPEN", "CCLOSE", "SWRITE", "STRCLEAR", "STRCOPY", "STRADD"), TEXT),
    **dict.fromkeys(
        ("MSGNOTIFY", "MSGQUIT", "MSGDIALOG", "MSGLOOP", "MSGCLEAR", "CLEAR_KRLMSG", "SET_KRLMSG", "SET_KRLDLG"), TEXT
    ),
    "PULSE": OUTPUT,
}

KRL_STATEMENTS: dict[str, str] = {
    "BRAKE": "stops a motion on its path within an interrupt",
    **dict.fromkeys(("ANIN", "ANOUT"), OUTPUT),
}
