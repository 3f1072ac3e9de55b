"""Robot program statements that cannot move points or frames, with the reason; one list per language.

A statement that is neither listed nor executed by the reader stops a plan (:mod:`machopt.toolpath.unknown_words`).
FANUC and Yaskawa statements are identified by their beginning.
"""

from __future__ import annotations

import re

_TEXT = "text for the operator, files or the network"
_OUTPUT = "switches outputs beside the motion"
_SPEED = "speed and acceleration within the controller's limits; points stay"
_ROUNDING = "how closely the controller follows; the robot keeps its own tolerance"
_PLANNING = "the controller's advance run and block coincidence"
_NUMBER = "counters, flags and timers that no point depends on here"
_LOAD = "mass and inertia that the controller plans with"
_CHECKS = "collision detection and other monitoring"
_READ_ONLY = "a copy of what is active, for the operator"

KRL_VARIABLES: dict[str, str] = {
    **dict.fromkeys(("$ADVANCE", "$BWDSTART", "$STOPNOAPROX"), _PLANNING),
    **dict.fromkeys(
        ("$ORI_TYPE", "$CIRC_TYPE", "$ORI_CHECK"),
        "the way between two orientations; at the points they are as programmed",
    ),
    **dict.fromkeys(("$APO", "$SPL_VEL_MODE", "$SPL_VEL_RESTR"), _ROUNDING),
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
        _SPEED,
    ),
    **dict.fromkeys(("$LOAD", "$LOAD_A1", "$LOAD_A2", "$LOAD_A3"), _LOAD),
    **dict.fromkeys(("$ACT_BASE", "$ACT_TOOL", "$ACT_EX_AX"), _READ_ONLY),
    "$H_POS": "the place of the home position, which moves to it use",
    **dict.fromkeys(("$LOOP_MSG", "$LOOP_CONT", "$MSG_T", "$ERR"), _TEXT),
    **dict.fromkeys(("$TIMER", "$TIMER_STOP", "$TIMER_FLAG"), _NUMBER),
    **dict.fromkeys(("$TORQ_DIFF", "$TORQ_DIFF2", "$TORQMON", "$TORQMON_DEF", "$TORQMON_COM"), _CHECKS),
    "$OUT_C": _OUTPUT,
}
KRL_CALLS: dict[str, str] = {
    **dict.fromkeys(("CWRITE", "COPEN", "CCLOSE", "SWRITE", "STRCLEAR", "STRCOPY", "STRADD"), _TEXT),
    **dict.fromkeys(
        ("MSGNOTIFY", "MSGQUIT", "MSGDIALOG", "MSGLOOP", "MSGCLEAR", "CLEAR_KRLMSG", "SET_KRLMSG", "SET_KRLDLG"), _TEXT
    ),
    "PULSE": _OUTPUT,
}
KRL_STATEMENTS: dict[str, str] = {
    "BRAKE": "stops a motion on its path within an interrupt",
    **dict.fromkeys(("ANIN", "ANOUT"), _OUTPUT),
}
RAPID: dict[str, str] = {
    **dict.fromkeys(("CONFL", "CONFJ"), "whether the robot checks its configuration; targets stay"),
    **dict.fromkeys(("SINGAREA", "CIRPATHMODE"), "the way of the wrist between two targets; the targets stay"),
    **dict.fromkeys(("ACCSET", "VELSET", "PATHACCLIM", "WORLDACCLIM"), _SPEED),
    **dict.fromkeys(("ACTUNIT", "DEACTUNIT"), "which further mechanical units are active"),
    **dict.fromkeys(
        ("SYNCMOVEON", "SYNCMOVEOFF", "WAITSYNCTASK", "WAITROB", "STARTMOVE", "STOPMOVE"), "when robots move, not where"
    ),
    **dict.fromkeys(("SOFTACT", "SOFTDEACT"), "stiffness of the servo control; targets stay"),
    **dict.fromkeys(("GRIPLOAD", "MECHUNITLOAD"), _LOAD),
    **dict.fromkeys(
        ("IDISABLE", "IENABLE", "IWATCH", "ISLEEP", "IDELETE", "CONNECT", "ISIGNALDI", "ISIGNALDO", "ITIMER"),
        "interrupts: they act only when something happens",
    ),
    **dict.fromkeys(("TRIGGIO", "TRIGGEQUIP", "TRIGGINT"), "prepares an output for TriggL, which is refused"),
    "SPEEDREFRESH": "the override, which is read and refused unless it is 100 %",
    "TPREADNUM": "a number from the operator; targets that need it are refused",
    **dict.fromkeys(("TPERASE", "TPWRITE", "ERRWRITE", "OPEN", "CLOSE", "WRITE", "UIMSGBOX"), _TEXT),
    "TPREADFK": "a number from the operator; targets that need it are refused",
    **dict.fromkeys(("EOFFSOFF", "PDISPOFF"), "ends a displacement; those that begin one are refused"),
    **dict.fromkeys(("CLKRESET", "CLKSTART", "CLKSTOP", "INCR", "DECR", "ADD", "CLEAR"), _NUMBER),
    "MOTIONSUP": _CHECKS,
}
FANUC: dict[str, str] = {
    "PAYLOAD": _LOAD,
    "TOOL_OFFSET CONDITION": "names the register of a shift; moves that use it are refused",
    "OFFSET CONDITION": "names the register of a shift; moves that use it are refused",
    **dict.fromkeys(("JOINT_MAX_SPEED", "LINEAR_MAX_SPEED"), _SPEED),
    **dict.fromkeys(("COL DETECT", "COL GUARD"), _CHECKS),
    **dict.fromkeys(("ERROR_PROG", "RESUME_PROG"), "which program runs after a fault"),
    **dict.fromkeys(("TIMER", "R[", "SR[", "F["), _NUMBER),
    "PR[": "a position register; moves to it or by it are refused",
    **dict.fromkeys(("MESSAGE", "REMARK", "UALM"), _TEXT),
    "RSR": "requests to start a program",
    **dict.fromkeys(("LOCK", "UNLOCK"), "whether the controller reads position registers ahead"),
    "MONITOR": _CHECKS,
    **dict.fromkeys(("GO[", "AO["), _OUTPUT),
    "POINT_LOGIC": _OUTPUT,
    "PALLETIZING": "moves to a pallet's positions are refused",
    **dict.fromkeys(("$WAITTMOUT", "$TIMER", "$SPEED", "$SHELL_WRK.$CUST_START"), _NUMBER),
    "TC_ONLINE": "torch angle control off or on; it changes no taught position",
    "-": "a heading",
}
JBI: dict[str, str] = {
    **dict.fromkeys(("NOP", "END", "SFTOF"), "does nothing, or ends what is refused when it begins"),
    **dict.fromkeys(("MSG", "COMM"), _TEXT),
    **dict.fromkeys(
        ("CLEAR", "SET", "INC", "DEC", "ADD", "SUB", "MUL", "DIV", "SETE", "GETE", "GETS", "CNVRT"),
        "variables; a change of a position that the job moves to is refused",
    ),
    "SETTOOL": "the dimensions of a tool; targets are those of its tip",
    "ARATION": _NUMBER,
    "REFP": "reference points of weaving",
    **dict.fromkeys(("DIN", "AIN", "SETREG", "GETREG"), "reads inputs and registers into variables"),
    **dict.fromkeys(("NWAIT", "CWAIT", "ADVINIT", "ADVSTOP"), "how far the controller reads ahead"),
    **dict.fromkeys(("SHCKSET", "SHCKRST"), _CHECKS),
    **dict.fromkeys(("HAND", "CLS"), _OUTPUT),
}
URSCRIPT: dict[str, str] = {
    **dict.fromkeys(("set_gravity", "set_payload", "set_target_payload"), _LOAD),
    **dict.fromkeys(("set_safety_mode", "protect"), _CHECKS),
    **dict.fromkeys(
        (
            "set_tool_voltage",
            "set_analog",
            "set_configurable",
            "write_port",
            "set_standard",
            "set_tool",
            "set_runstate",
            "set_input_actions",
        ),
        _OUTPUT,
    ),
    "set_conveyor": "tick counts of a conveyor; following one is refused",
    **dict.fromkeys(("textmsg", "socket_", "modbus", "rtde", "popup"), _TEXT),
    **dict.fromkeys(
        ("stopj", "stopl", "sync", "enter_critical", "exit_critical", "return"), "when the robot moves, not where"
    ),
    **dict.fromkeys(
        ("zero_ftsensor", "end_force_mode", "enable_external_ft_sensor"),
        "the force sensor, and force control off; it is refused when it begins",
    ),
}
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
    **dict.fromkeys(("put", "putln", "logMsg", "popUpMsg", "cls", "userPage", "gotoxy", "title"), _TEXT),
}
VAL3_TYPES: dict[str, str] = dict.fromkeys(("num", "bool", "string", "dio", "aio", "sio"), _NUMBER)


def compile_beginning_pattern(words: dict[str, str]) -> re.Pattern[str]:
    """Compile a pattern for statements that begin with one of the words; a word that ends with a letter ends there.

    Args:
        words: Word → reason why it cannot move anything.

    Returns:
        The pattern.
    """
    ordered = sorted(words, key=len, reverse=True)
    return re.compile("|".join(re.escape(w) + (r"(?![A-Z])" if w[-1].isalpha() else "") for w in ordered))
