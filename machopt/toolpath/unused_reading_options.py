"""Reading options without effect on the given file, which are refused or reported.

An option applies to kinds of files (:data:`APPLIES`). Within such a file it can still have no effect: an offset that
the file does not use, a word that it does not contain.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from machopt.data_types.toolpath import Toolpath
from machopt.errors import FileFormatError, OptionError
from machopt.file_formats.source_file import ReadOptions, normalise_word
from machopt.path_building.point_collector import USED

APT, G_CODE, SINUMERIK, HEIDENHAIN, NCI, ROBOT, TABLE = (
    "APT/CL data",
    "G-code",
    "Sinumerik programs",
    "Heidenhain programs",
    "Mastercam NCI",
    "robot programs",
    "point tables",
)
ALL = (APT, G_CODE, SINUMERIK, HEIDENHAIN, NCI, ROBOT, TABLE)
CONTROLS = (G_CODE, SINUMERIK, HEIDENHAIN)
APPLIES = {  # option → kinds of files that it can have an effect on
    "--unit": ALL,
    "--feed": ALL,
    "--strict": ALL,
    "--accept-unknown": ALL,
    "--machine": CONTROLS,
    "--offset": CONTROLS,
    "--decimals": (G_CODE,),
    "--cycle-order": (APT,),
    "--tool-axis": (ROBOT, TABLE),
    "--kind": (TABLE,),
}
TRACKED = ("--feed", "--cycle-order", "--tool-axis")  # readers note in ``used_options`` where they take them
DEFAULTS = {"tool_axis": "-z", "cycle_order": ("depth", "clear", "retract")}


def find_file_kind(toolpath: Toolpath) -> str:
    """Find the kind of file a toolpath was read from.

    Args:
        toolpath: The toolpath.

    Returns:
        One of :data:`ALL`.
    """
    head = toolpath.format.partition("/")[0]
    if head == "gcode" and toolpath.meta.get("control") == "sinumerik":
        return SINUMERIK
    return {"apt": APT, "gcode": G_CODE, "nci": NCI, "robot": ROBOT}.get(
        head, HEIDENHAIN if head.startswith("heidenhain") else TABLE
    )


def check_reading_options(path: Path, toolpath: Toolpath, options: ReadOptions) -> Toolpath:
    """Refuse options that do not apply to a kind of file; warn of those without effect on this file.

    Args:
        path: Path of the file.
        toolpath: The toolpath that was read.
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Returns:
        The toolpath with its warnings.

    Raises:
        FileFormatError: names the option, the kind of file, and what the option applies to.
    """
    kind = find_file_kind(toolpath)
    for option in list_given_options(options):
        if kind not in APPLIES[option]:
            raise FileFormatError(
                f"{option} has no effect on this file ({kind}); it applies to {', '.join(APPLIES[option])}. "
                "Expected a call without it",
                file=path,
                where=option,
            )
    _check_words(path, toolpath, options)
    meta = dict(toolpath.meta)
    used = meta.pop(USED, "").split()
    idle = [o for o in list_given_options(options) if o in TRACKED and o not in used]
    warnings = tuple(f"{o} has no effect on this file" for o in idle)
    return replace(toolpath, meta=meta, warnings=(*toolpath.warnings, *warnings))


def list_given_options(options: ReadOptions) -> list[str]:
    """List the options with a value other than the default.

    Args:
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Returns:
        Names of the options.
    """
    given = {
        "--unit": options.unit is not None,
        "--feed": options.default_feed is not None,
        "--strict": options.strict,
        "--accept-unknown": bool(options.accept_unknown),
        "--machine": options.machine is not None,
        "--offset": bool(options.offsets),
        "--decimals": options.decimals is not None,
        "--cycle-order": options.cycle_order != DEFAULTS["cycle_order"],
        "--tool-axis": options.tool_axis != DEFAULTS["tool_axis"],
        "--kind": options.kind is not None,
    }
    return [option for option, is_given in given.items() if is_given]


def _check_words(path: Path, toolpath: Toolpath, options: ReadOptions) -> None:
    unknown = {normalise_word(w.word) for w in toolpath.ignored if not w.understood}
    lacking = [w for w in options.accept_unknown if w not in unknown]
    if lacking:
        known = ", ".join(sorted(w.word for w in toolpath.ignored if not w.understood)) or "none"
        raise OptionError(
            f"the file has no unknown word {lacking[0]!r}; its unknown words: {known}",
            file=path,
            where="--accept-unknown",
        )
