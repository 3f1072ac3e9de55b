"""What the G and M words mean here. Keys are ten times the number, so G43.4 is 434."""

from __future__ import annotations

MOTION = {0: 0, 10: 1, 20: 2, 30: 3}
CYCLES = {730, 740, 760, 770, 810, 820, 830, 840, 850, 860, 870, 880, 890}
UNITS = {200: "inch", 210: "mm", 700: "inch", 710: "mm", 7000: "inch", 7100: "mm"}
PLANES = {170: (0.0, 0.0, 1.0), 180: (0.0, 1.0, 0.0), 190: (1.0, 0.0, 0.0)}
FEED_MODES = {930: "inverse", 940: "minute", 950: "revolution"}
OFFSETS = {540, 550, 560, 570, 580, 590, *range(541, 542), 591, 592, 593, *range(5000, 6000, 10)}

# Known, and without effect on the points.
NO_EFFECT = {
    51, 80, 81, 90, 131, 150, 231, 400, 430, 440, 450, 451, 490, 500, 501, 600, 601, 602, 610, 611, 620, 630, 640,
    670, 690, 960, 970, 980, 990, 1491, 1870, 2470, 6410, 6420, 6430, 6440, 6450,
}  # fmt: skip

# Axis words of these blocks go to the machine's own frame.
MACHINE_FRAME = {
    280: "G28", 300: "G30", 530: "G53", 281: "G28.1", 301: "G30.1", 1530: "G153", 740: "G74", 750: "G75",
}  # fmt: skip

REFUSED = {
    683: "G68.3 tilts the working plane; its rotation is not followed",
    510: "G51 scales or mirrors the coordinates that follow",
    511: "G51.1 mirrors the coordinates that follow",
    160: "G16 polar coordinates are not supported",
    70: "G7 tilts the working plane or programs diameters",
    1410: "G141 (tool-centre point by vectors of another control) is not supported",
    330: "G33 thread cutting is not supported",
    50: "G5 splines are not supported",
    52: "G5.2 splines are not supported",
    60: "G6 splines are not supported",
    1200: "G12 pocket cycles are not supported",
    650: "G65 calls a macro whose motion is not in the file",
    660: "G66 calls a macro whose motion is not in the file",
}
REFUSED_CALLS = {
    **dict.fromkeys(
        ("FOR", "ENDFOR", "WHILE", "ENDWHILE", "IF", "ELSE", "ENDIF", "GOTOB", "GOTOF", "GOTO", "REPEAT", "LOOP", "DEF",
         "UNTIL", "CASE", "PROC", "THEN", "ENDLOOP", "EXTERN", "CALL", "PCALL", "REPEATB"),
        "this program logic is not followed; expand the program first",
    ),
    **dict.fromkeys(
        ("SCALE", "ASCALE", "MIRROR", "AMIRROR", "ROTS", "AROTS", "CROTS", "TOROTX", "TOROTY", "TOFRAMEX", "TOFRAMEY"),
        "it changes the coordinate system; export in one fixed system",
    ),
    **dict.fromkeys(
        ("CIP", "CT", "BSPLINE", "ASPLINE", "CSPLINE", "POLY", "HOLES1", "HOLES2", "POCKET3", "POCKET4", "LONGHOLE",
         "SLOT1", "SLOT2", "CYCLE71", "CYCLE72", "CYCLE76", "CYCLE77"),
        "this motion is not supported; export it as G1, G2 and G3",
    ),
}  # fmt: skip
IGNORED_CALLS = {
    "MSG", "ORIWKS", "ORIMKS", "ORIVECT", "ORIAXES", "ORIMACHAX", "FFWON", "FFWOF", "SOFT", "BRISK", "COMPOF",
    "COMPCAD", "COMPON", "COMPCURV", "CYCLE832", "STOPRE", "SUPA", "TRAORI", "TRAFOOF", "TRAOOF", "FGROUP", "CFTCP",
    "CFC", "CFIN", "FNORM", "DIAMOF", "UPATH", "SPATH", "NORM", "WORKPIECE", "FIFOCTRL", "TOFFOFF", "DISPLOF", "SAVE",
    "MCALL", "TOROT", "TOFRAME", "TOROTOF", "TRANS", "ROT",
}  # fmt: skip
NO_EFFECT_NAMES = {
    "ADIS",
    "ADISPOS",
    "SPOS",
    "SPOSA",
    "FRC",
    "FRCM",
    "ACC",
    "OVR",
    "VELOLIM",
    "FP",
    "M1",
    "M2",
    "S1",
    "S2",
}
NO_EFFECT_M = {*range(10, 20), *range(40, 46), 19, 20, 21, 22, 23, 48, 49, 60, 61, 88, 89}
PROGRAM_END = {2, 30, 99}
