"""What each CL word means to a toolpath: nothing, an event, or a reason to refuse the file."""

from __future__ import annotations

# Known and without effect on where the tool tip goes.
NO_EFFECT = frozenset(
    [
        "PAINT",
        "AUTOPS",
        "ISN",
        "PPFUN",
        "REWIND",
        "TLDATA",
        "MACHIN",
        "PARTNO",
        "CUTTER",
        "INTOL",
        "OUTTOL",
        "TOLER",
        "DISPLY",
        "SELECT",
        "SETUP",
        "TRNTYP",
        "MULTAX",
        "SWITCH",
        "BOX",
        "TPRINT",
        "SEQNO",
        "REMARK",
        "PRINT",
        "OPSKIP",
        "LEADER",
        "TMARK",
        "PREFUN",
        "AUXFUN",
        "CLAMP",
        "FINI",
        "END",
        "UNIT",
        "UNITS",
        "END-OF-PATH",
        "OPFEATEND",
        "CSI_SET_FLUTE_LENGTH",
        "CSI_SET_EXTENSION_LENGTH",
        "LINTOL",
        "ARCSLP",
        "PIVOTZ",
        "PLABEL",
        "BREAK",
        "CLDIST",
        "CLRSRF",
        "NOPOST",
        "POSTN",
        "OPTION",
        "THREAD",
        "VTLAXS",
        "GRID",
        "LINCIR",
        "SLOWDN",
        "PROBE",
        "TOOLPN",
        "HEAD",
        "CUTANG",
        "WPLANE",
    ]
)

# They move the tool, the part or the coordinates in a way this reader does not follow.
REFUSED = {
    **dict.fromkeys(
        ("GO", "GOFWD", "GOBACK", "GOLFT", "GORGT", "GOUP", "GODOWN", "TLLFT", "TLRGT", "TLOFPS", "PSIS"),
        "drive-surface motion needs the APT processor; export the cutter location file instead",
    ),
    **dict.fromkeys(
        ("ROTATE", "ROTHED", "INDEX", "COPY", "TRACUT", "REFSYS", "ORIGIN", "TRANS", "TRANSL"),
        "it moves or copies the coordinates that follow; export without it, in one machining axis system",
    ),
    **dict.fromkeys(
        ("CALLSUB", "CALL", "MACRO", "LOOPST", "JUMPTO", "JUMP", "IF", "DO"),
        "program logic is not followed; export the expanded cutter location file",
    ),
    **dict.fromkeys(
        ("HELICAL", "SPLINE", "TURN", "LATHE"),
        "this kind of motion is not supported; export it as GOTO points or CIRCLE",
    ),
}
