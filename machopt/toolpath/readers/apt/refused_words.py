"""CL words that make a file unsupported; words without effect are in :mod:`machopt.toolpath.readers.harmless_words`."""

from __future__ import annotations

# They move the tool, the part or the coordinates in a way this reader does not follow.
REFUSED = {
    **dict.fromkeys(
        ("GO", "GOFWD", "GOBACK", "GOLFT", "GORGT", "GOUP", "GODOWN", "TLLFT", "TLRGT", "TLOFPS", "PSIS"),
        "drive-surface motion needs the APT processor; export the cutter location file instead",
    ),
    **dict.fromkeys(
        (
            "ROTATE",
            "ROTHED",
            "INDEX",
            "COPY",
            "TRACUT",
            "REFSYS",
            "TRANSL",
            "MIRROR",
            "MIRRX",
            "MIRRY",
            "MATRIX",
            "MOVE",
        ),
        "it moves or copies the coordinates that follow; export without it, in one machining axis system",
    ),
    **dict.fromkeys(
        ("CALLSUB", "CALL", "MACRO", "LOOPST", "JUMPTO", "JUMP", "IF", "DO"),
        "program logic is not followed; export the expanded cutter location file",
    ),
    **dict.fromkeys(
        ("HELICAL", "SPLINE", "TURN", "LATHE", "THREAD", "PROBE", "POCKET", "ARCMOV", "GOCLER"),
        "this kind of motion is not supported; export it as GOTO points or CIRCLE",
    ),
}
