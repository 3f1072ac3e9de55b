"""Words that are understood and do not change the path, each with the reason.

A word that is not listed changes the path in its reader, is refused there, or is reported as not understood.
``CARRIED_OUT`` lists words that count as understood although their reader uses them. G codes are ten times the
number: G43.4 is 434.
"""

from __future__ import annotations

_LENGTH = "tool length: programmed coordinates are those of the tip"
_SMOOTH = "how closely and quickly the control follows; the robot keeps its own tolerance and limits"
_STOPS = "exact stop or continuous path at block ends; the corner points are the same"
_DISPLAY = "shown to the operator or used by the simulation only"
_SPINDLE = "turns or positions the spindle about the tool's own axis"
_MACHINE = "a function of the machine other than its axes (clamps, doors, chips, gears)"
_OFF = "switches off what is refused when it is switched on"
_RECORD = "names, times, tools or features for people and post processors"

G: dict[int, str] = {
    **dict.fromkeys((80, 81, 1870), _SMOOTH),  # G8, G8.1, G187
    **dict.fromkeys((90, 610, 611, 620, 640), _STOPS),
    **dict.fromkeys((6010, 6020, 6030, 6410, 6420, 6430, 6440, 6450), _STOPS + " (Sinumerik)"),
    **dict.fromkeys((4500, 4510), "corners of cutter compensation, which is not carried out"),
    400: "cutter compensation off",
    **dict.fromkeys((430, 440, 490), _LENGTH),
    **dict.fromkeys((110, 131, 670, 1130), _OFF),  # G11, G13.1, G67, G113
    **dict.fromkeys((220, 230), "limits of the machine's working space"),
    **dict.fromkeys((960, 970), "spindle speed by surface speed; feeds per minute stay"),
    630: "tapping mode: override off (with axis words it is refused)",
    600: "exact stop of Sinumerik (with axis words it is refused elsewhere)",
}
M: dict[int, str] = {
    **dict.fromkeys((10, 11, 88, 89), _MACHINE),
    **dict.fromkeys((18, 19), _SPINDLE),
    **dict.fromkeys(range(40, 46), _MACHINE),
    **dict.fromkeys((48, 49), "overrides of the operator on or off"),
    60: "pallet or part change: the program's coordinates stay",
    **dict.fromkeys((29, 135), "rigid tapping: the spindle follows the feed; the cycle states the stroke"),
    **dict.fromkeys((31, 32, 33, 34, 35), _MACHINE),  # chip conveyor, coolant nozzle
    **dict.fromkeys((50, 51, 52, 53), "overrides of the operator, or coolant through the spindle"),
    **dict.fromkeys((59, *range(62, 69)), "switches or reads inputs and outputs"),
}
G_LETTERS: dict[str, str] = {
    "T": "preselects a tool; M6 changes it",
    "H": _LENGTH,
    "D": "cutter compensation's offset, which is not carried out",
    "E": "thread pitch or extruder, which move no axis of the tool",
}
SINUMERIK_CALLS: dict[str, str] = {
    **dict.fromkeys(
        ("MSG", "DISPLOF", "DISPLON", "WORKPIECE", "PRINTLN", "ACTBLOCNO", "GROUP_BEGIN", "GROUP_END"), _DISPLAY
    ),
    "SETMS": "which spindle S and M3 mean",
    **dict.fromkeys(
        (
            "FFWON",
            "FFWOF",
            "SOFT",
            "BRISK",
            "DRIVE",
            "COMPOF",
            "COMPCAD",
            "COMPON",
            "COMPCURV",
            "CYCLE832",
            "FIFOCTRL",
            "SPCON",
            "SPCOF",
            "ORISON",
            "ORISOF",
            "DYNNORM",
            "DYNPOS",
            "DYNROUGH",
            "DYNSEMIFIN",
            "DYNFINISH",
            "DYNPREC",
            "CPRECON",
            "CPRECOF",
        ),
        _SMOOTH,
    ),
    **dict.fromkeys(
        ("ORIWKS", "ORIMKS", "ORIVECT", "ORIPLANE", "ORIAXES", "ORIMACHAX"),
        "the way between two tool axes; at the points they are as programmed",
    ),
    **dict.fromkeys(
        ("ORIEULER", "ORIRPY", "ORIRPY2", "ORIVIRT1", "ORIVIRT2"),
        "the order of the turns A2=, B2=, C2=, which are refused; it does not affect axes as vectors (A3=)",
    ),
    **dict.fromkeys(
        ("CFTCP", "CFC", "CFIN", "NORM", "KONT", "CDOF", "CUTCONOF"),
        "feeds and approaches of cutter compensation, which is not carried out",
    ),
    **dict.fromkeys(("FNORM", "UPATH", "SPATH"), "the control's default for feed and path parameter"),
    **dict.fromkeys(
        ("STOPRE", "STOPREOF", "SAVE", "SBLON", "SBLOF", "ICYCON", "ICYCOF"), "order of the control's own work"
    ),
    **dict.fromkeys(
        ("INIT", "START", "WAITM", "WAITMC", "WAITE", "WAITP", "WAITS", "SETM", "CLEARM", "GET", "GETD", "RELEASE"),
        "channels and positioning axes wait for each other or change hands",
    ),
    **dict.fromkeys(("TOFFOFF", "DIAMOF", "TOROTOF", "PAROTOF"), _OFF),
}
SINUMERIK_NAMES: dict[str, str] = {
    **dict.fromkeys(("ADIS", "ADISPOS", "CTOL", "ATOL", "OTOL"), _SMOOTH),
    **dict.fromkeys(("SPOS", "SPOSA", "M1", "M2", "M3", "M4", "S1", "S2", "S3", "S4", "LIMS"), _SPINDLE),
    **dict.fromkeys(("ACC", "VELOLIM"), "limits of the machine's axes; the robot has its own"),
    **dict.fromkeys(("A4", "B4", "C4", "A5", "B5", "C5"), "the surface's normal, for cutter compensation only"),
    "FP": "which fixed point G75 goes to; that move is the machine's",
}
HEIDENHAIN: dict[str, str] = {
    **dict.fromkeys(("BLK FORM", "TOOL DEF", "FUNCTION COUNT"), _DISPLAY),
    **dict.fromkeys(("FN 15", "FN 16", "FN 38"), "texts for the screen, files or the network"),
    "FUNCTION MODE MILL": "milling, which is read anyway",
    **dict.fromkeys(
        ("FUNCTION FEED DWELL", "FUNCTION RESET FEED DWELL", "FUNCTION DWELL"), "waits; the points are the same"
    ),
    **dict.fromkeys(("FUNCTION S-PULSE", "FUNCTION RESET S-PULSE"), _SPINDLE),
    "END PGM": "the end",
    "LBL": "a place that jumps name; the jumps are followed",
    "STOP": "kept as an event",
}
HEIDENHAIN_M: dict[int, str] = {
    **dict.fromkeys((116, 117), "feeds of moves of rotary axes alone"),
    **dict.fromkeys((94, 126, 127), "the way round a rotary axis takes to an angle; the angle is the same"),
    **dict.fromkeys((97, 98, 120), "corners of cutter compensation, which is not carried out"),
    **dict.fromkeys((101, 102, 107, 108), "spare tools and their oversizes"),
    **dict.fromkeys((118, 150), "the operator's handwheel, messages of the control"),
}
HEIDENHAIN_CYCLES: dict[int, str] = {
    9: "dwell, kept as an event",
    13: _SPINDLE,
    32: _SMOOTH,
    238: "measures the state of the machine's axes",
    239: "the load on the table, for the control's drives",
    **dict.fromkeys((332, 392), _SMOOTH),
    247: "the datum preset; another one than the first is a work offset",
}
DIN_ISO: dict[int, str] = {
    17: "the plane whose axis is the tool's",
    **dict.fromkeys((29, 30, 31, 38, 99), "pole from the place, blank form, stop, tool definition"),
    **dict.fromkeys((40, 51, 62), "compensation off, tool preselection, tolerance"),
    **dict.fromkeys((70, 71, 90, 91), "units and increments, which the reader uses"),
}
APT: dict[str, str] = {
    **dict.fromkeys(
        (
            "PAINT",
            "DISPLY",
            "BOX",
            "SELECT",
            "SETUP",
            "CSI_SET_FLUTE_LENGTH",
            "CSI_SET_EXTENSION_LENGTH",
            "SET_FLUTE_LENGTH",
            "CUTTER_TYPE",
            "CUTCOM_GEOMETRY_TYPE",
            "CUTTER",
        ),
        _DISPLAY,
    ),
    **dict.fromkeys(
        (
            "PARTNO",
            "MFGNO",
            "FEATNO",
            "TOOL_NAME",
            "TPRINT",
            "REMARK",
            "PRINT",
            "SEQNO",
            "ISN",
            "AUTOPS",
            "PLABEL",
            "LEADER",
            "TMARK",
            "REWIND",
            "OPTION",
            "MACHIN",
            "PPFUN",
            "NOPOST",
            "POSTN",
            "TLDATA",
            "TOOLPN",
            "TOOLNO",
            "FINI",
            "END",
            "END-OF-PATH",
            "OPFEATEND",
            "UNIT",
            "UNITS",
        ),
        _RECORD,
    ),
    **dict.fromkeys(("INTOL", "OUTTOL", "TOLER", "LINTOL", "ARCSLP", "LINCIR", "SLOWDN"), _SMOOTH),
    **dict.fromkeys(
        (
            "BEGIN",
            "MATERL",
            "MATERIAL",
            "OPNAME",
            "OPTYPE",
            "APPLY",
            "TITLES",
            "NOPLOT",
            "LETTER",
            "DRAFT",
            "PPLOT",
            "PENUP",
            "PENDWN",
            "OVPLOT",
            "INTCOD",
            "STOCK",
            "STKGEO",
            "PRTGEO",
            "CATPROCESS",
            "TOOLCHANGEBEGINNING",
            "TOOLCHANGEEND",
        ),
        _RECORD,
    ),
    **dict.fromkeys(("CLAMP", "OPSKIP", "SWITCH", "HEAD", "BREAK", "AIR", "MAGTAP", "RESET"), _MACHINE),
    **dict.fromkeys(
        ("SELCTL", "TURRET", "UNLOAD"), "takes a tool from or to the magazine; LOADTL names the one in use"
    ),
    **dict.fromkeys(("MCHTOL", "MCHFIN", "MAXVEL", "MAXDPM"), _SMOOTH),
    "CHECK": "limits of the machine that the post watches",
    "PITCH": "pitch of threads that are cut by other statements",
    **dict.fromkeys(
        ("CLDIST", "CLRSRF"), "clearance of moves that the post adds; cycles must name theirs, and those are read"
    ),
    "PIVOTZ": "a length of the machine's head; GOTO names the tip",
    "WPLANE": "whether the post writes tilted planes; GOTO stays in the part's system",
}
APT_SET: dict[str, str] = {
    "MODE": "increments, which the reader uses",
    **dict.fromkeys(("HOLDER", "TOOL"), _LENGTH),
}
APT_FEDRAT: dict[str, str] = dict.fromkeys(("LOCK", "ON", "OFF"), "holds or releases the operator's override")
NCI: dict[int, str] = {
    **dict.fromkeys((1009, 1010, 1015, 1016, 1018, 1019, 1020, 1021, 1022, 1023, 1024, 1028, 1040, 1050), _RECORD),
    **dict.fromkeys((1011, 1012, 1013), "tool, home and miscellaneous numbers of an operation"),
    1017: "the tool plane's name; its matrix is record 1014",
    1027: "the work coordinate system's view; points are those of the tool plane (1014)",
    **dict.fromkeys((1051, 1052, 1053, 1054, 1055), _RECORD),
    **dict.fromkeys((950, 951, 952, 953, 960, 970, 999), _RECORD),
}
CARRIED_OUT: dict[str, str] = {  # words that a reader uses, and lines that hold no program
    "T": G_LETTERS["T"],
    "H": G_LETTERS["H"],
    "D": G_LETTERS["D"],
    "E": G_LETTERS["E"],
    "G41": "cutter compensation is not carried out, and the first one is warned of",
    "G42": "cutter compensation is not carried out, and the first one is warned of",
    "CUTCOM": "points are the tool's; the first one is warned of",
    "G10": "work offsets before the path: kept, or refused within it",
    "G43.1": "tool length by numbers (LinuxCNC): programmed coordinates are those of the tip",
    "G52": "shifts the origin",
    "G92": "shifts the origin",
    "G92.1": "shifts the origin",
    "G92.2": "shifts the origin",
    "move in the machine's frame": "the coordinates it moves are unknown until they are programmed again",
    "rapid with turned rotary axes and no tool-centre-point control": "left out: its place is not known",
    "rapid in a tilted plane while a coordinate is not known": "left out: its place is not known",
    "text after the program end": "no program",
    "information listing header": "no program",
    "/ (block delete; the block is read)": "read as if the switch were off",
    "G5": "high speed mode (G5 P10000, G5.1 Q1)",
    "G28.1": "stores the present place (LinuxCNC); with axis words it is refused",
    "G30.1": "stores the present place (LinuxCNC); with axis words it is refused",
    "M70": "saves, forgets or restores modes (M70 to M73, LinuxCNC)",
    "PRESET SELECT": "another preset is another work offset",
    "CYCL DEF 7": "shifts the datum",
    "CYCL DEF 8": "mirrors X, Y",
    "G28": "mirrors X, Y (Heidenhain DIN/ISO)",
    "CYCL DEF 10": "turns the plane",
    "CYCL DEF 11": "scales lengths",
    "CYCL DEF 26": "scales lengths",
    "SUPA": "suppresses offsets: a move in the machine's frame",
    "TRAORI": "tool-centre-point control",
    "TRAFOOF": "tool-centre-point control off",
    "TRAOOF": "tool-centre-point control off",
    "MCALL": "a cycle at the points that follow",
    "TOROT": "only where the plane is tilted so already",
    "TOFRAME": "only where the plane is tilted so already",
    "FGROUP": "feeds of X, Y and Z together, the default",
    "TRANS": "shifts points",
    "ORIGIN": "where the machine's zero lies; on the way it is refused",
    "GOHOME without coordinates": "the machine's own place",
    "$$ comment": "no statement",
    "ROTABL": "turns the table; cuts at two places are refused",
    "TLAXIS": "CLT: of the part, whose points are in the tool's system",
    "TRNTYP": "which system points are in",
    "MODE": "increments or the kind of machine",
    "MULTAX": "whether GOTO has six numbers",
    "CYCLE/CLEAR": "ends a cycle",
    "CYCLE/INIT": "before a cycle is named",
    "parameters (10000 …)": "numbers of Mastercam's pages",
    "1000": "names a tool",
    "1001": "names a tool",
    "1002": "names a tool",
}
