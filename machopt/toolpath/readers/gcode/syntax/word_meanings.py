"""Meaning of the G and M words. Keys are ten times the number: G43.4 is 434."""

from __future__ import annotations

MOTION = {0: 0, 10: 1, 20: 2, 30: 3}
CYCLES = {730, 740, 760, 770, 810, 820, 830, 840, 850, 860, 870, 880, 890}
UNITS = {200: "inch", 210: "mm", 700: "inch", 710: "mm", 7000: "inch", 7100: "mm"}
HOLE_PATTERNS = {700, 710, 720}  # Haas: with I, J, K or L; else units, or G72 of other controls
PLANES = {170: (0.0, 0.0, 1.0), 180: (0.0, 1.0, 0.0), 190: (1.0, 0.0, 0.0)}
FEED_MODES = {930: "inverse", 940: "minute", 950: "revolution"}
OFFSETS = {540, 550, 560, 570, 580, 590, 541, 591, 592, 593, *range(5000, 6000, 10), 1540, *range(1140, 1300, 10)}
MANY_OFFSETS = {541, 1540}  # G54.1 P, G154 P

# Axis words of these blocks go to the machine's own frame.
MACHINE_FRAME = {280: "G28", 300: "G30", 530: "G53", 1530: "G153", 740: "G74", 750: "G75"}

TABLE_OFFSETS = {542, 544}  # G54.2, G54.4; P0: off
REFUSED = {
    542: "G54.2 (dynamic fixture offset) shifts points by the position of the table",
    544: "G54.4 (error of the workpiece's seat) turns and shifts points by numbers of the control",
    683: "G68.3 tilts the working plane; its rotation is not followed",
    **dict.fromkeys((450, 460, 470, 480), "G45 to G48 move by tool offsets that only the control knows"),
    **dict.fromkeys((121, 1120), "G12.1 (G112) interpolates in polar coordinates of a rotary axis"),
    **dict.fromkeys((71, 1070), "G7.1 (G107) interpolates on a cylinder"),
    **dict.fromkeys(
        (281, 301), "G28.1 and G30.1 with axis words move the axes of some controls and store a place on others"
    ),
    51: "G5.1 with axis words is a spline",
    270: "G27 moves to the reference point",
    290: "G29 moves from the reference point",
    310: "G31 moves until a probe touches",
    70: "G7 tilts the working plane or programs diameters",
    1410: "G141 (tool-centre point by vectors of another control) is not supported",
    330: "G33 thread cutting is not supported",
    332: "G33.2 thread cutting is not supported",
    50: "G5 splines are not supported",
    52: "G5.2 splines are not supported",
    60: "G6 splines are not supported",
    **dict.fromkeys((120, 130), "G12 and G13 mill a circular pocket"),
    1500: "G150 mills a pocket",
    **dict.fromkeys((1470, 1480, 2470, 2480, 3470, 3480), "G147 to G348 come to and leave a contour by themselves"),
    650: "G65 calls a macro whose motion is not in the file",
    660: "G66 calls a macro after every move that follows; write the calls (G65) themselves",
}
REFUSED_CALLS = {
    **dict.fromkeys(("LEAD", "TILT"), "the tool axis counts from the path and its surface; export tool vectors (A3=)"),
    **dict.fromkeys(("A2", "B2", "C2"), "tool axes by turns whose order a machine datum says; export vectors (A3=)"),
    "FZ": "feed per tooth; write F in mm/min",
    "OVR": "it scales the feeds that follow; write the feeds themselves",
    **dict.fromkeys(
        (
            "FOR",
            "ENDFOR",
            "WHILE",
            "ENDWHILE",
            "IF",
            "ELSE",
            "ENDIF",
            "GOTOB",
            "GOTOF",
            "GOTO",
            "REPEAT",
            "LOOP",
            "DEF",
            "UNTIL",
            "CASE",
            "PROC",
            "THEN",
            "ENDLOOP",
            "EXTERN",
            "CALL",
            "PCALL",
            "REPEATB",
        ),
        "this program logic is not followed; expand the program first",
    ),
    **dict.fromkeys(
        ("ROTS", "AROTS", "CROTS", "TOROTX", "TOROTY", "TOFRAMEX", "TOFRAMEY", "PAROT", "GFRAME", "CTRANS"),
        "it changes the coordinate system; export in one fixed system",
    ),
    **dict.fromkeys(
        ("TRANSMIT", "TRACYL", "TRAANG", "TRACON", "TRAILON", "OFFN", "DIAMON", "DIAM90", "TOFFON", "TOFF", "TOFFL"),
        "it makes the axes mean something else; export it without, as G0 to G3",
    ),
    **dict.fromkeys(
        (
            "BSPLINE",
            "ASPLINE",
            "CSPLINE",
            "POLY",
            "INVCW",
            "INVCCW",
            "POCKET3",
            "POCKET4",
            "LONGHOLE",
            "SLOT1",
            "SLOT2",
            "CYCLE71",
            "CYCLE72",
            "CYCLE76",
            "CYCLE77",
            "MEAS",
            "MEAW",
            "MEASA",
            "FXS",
            "REPOSA",
            "REPOSL",
            "CHKDNO",
        ),
        "this motion is not supported; export it as G1, G2 and G3",
    ),
}
PROGRAM_END = {2, 30, 99}
POLES = {1100, 1110, 1120}  # Sinumerik
ADDRESSES = frozenset(  # names of values behind an equals sign, which the readers take
    (
        "CR",
        "AR",
        "A3",
        "B3",
        "C3",
        "TURN",
        "RPL",
        "RND",
        "RNDM",
        "CHF",
        "CHR",
        "FRC",
        "FRCM",
        "AP",
        "RP",
        "ANG",
        "I1",
        "J1",
        "K1",
        "FB",
        ",R",
        ",C",
        ",A",
    )
)
