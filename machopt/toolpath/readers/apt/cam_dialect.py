"""Detection of the CAM system and the length unit of a cutter location file."""

from __future__ import annotations

import enum
import re

from machopt.file_formats.source_file import MM_PER_INCH, ReadOptions, SourceFile
from machopt.path_building.point_collector import PathBuilder
from machopt.toolpath.readers.apt.statement_parser import split_fields


class CamDialect(enum.Enum):
    """CAM system that wrote the file; the value is the format's name."""

    NX = "apt/nx"
    CATIA = "apt/catia"
    CAMWORKS = "apt/camworks"
    CLT = "apt/camworks-clt"
    CREO = "apt/creo"
    HSM = "apt/hsm"
    GENERIC = "apt"


def detect_dialect(source: SourceFile) -> CamDialect:
    """Detect the CAM system whose words the first lines hold.

    Args:
        source: Lines of the file, with its path and the builders of its errors.

    Returns:
        The dialect; plain APT where no word of a CAM system occurs.
    """
    head = "\n".join(source.lines[:400]).upper()
    if "TOOL PATH/" in head or "TLDATA/" in head or "MSYS/" in head:
        return CamDialect.NX
    if "*CATIA" in head or "CATIA APT" in head or "TLON,GOFWD" in head:
        return CamDialect.CATIA
    if "OPFEATSTART/" in head or "ROTABL/" in head:
        return CamDialect.CLT
    if "CSI_SET_" in head or ("CSYS/" in head and "TRNTYP/" in head):
        return CamDialect.CAMWORKS
    if "PRO/CLFILE" in head or "$$-> MFGNO" in head or "$$-> CSYS" in head or "$$->CSYS" in head:
        return CamDialect.CREO
    if re.search(r"^\s*MODE\s*/\s*(?:MILL|TURN)", head, re.MULTILINE) and "PARTNO/'" in head:
        return CamDialect.HSM
    return CamDialect.GENERIC


def parse_unit(rest: str) -> float | None:
    """Convert the argument of a UNITS statement to a length factor.

    Args:
        rest: Text behind the slash of the statement.

    Returns:
        mm per unit, None where the statement names no unit.
    """
    word = (split_fields(rest) or [""])[0]
    if word in ("MM", "METRIC"):
        return 1.0
    return MM_PER_INCH if word in ("INCH", "INCHES", "IN", "ENGLISH") else None


def find_unit_scale(source: SourceFile, options: ReadOptions, out: PathBuilder) -> float:
    """Find the length unit of the file.

    The UNITS word or the words of the feeds decide first, then the option.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).
        out: Path builder that takes the points and warnings.

    Returns:
        mm per unit of the file.

    Raises:
        InputError: units are mixed, contradict the option, or are neither in the file nor given as an option.
    """
    named: dict[str, int] = {}
    feeds: dict[str, int] = {}
    for line, raw in enumerate(source.lines, 1):
        text = raw.upper()
        if "UNIT" in text and (found := re.match(r"\s*(?:\$\$\s*)?UNITS?\s*[/:]\s*([A-Z]+)", text)):
            word = found.group(1)
            if word in ("MM", "CM", "M", "INCH", "INCHES", "IN", "FT", "FEET", "METRIC", "ENGLISH"):
                if word in ("CM", "M", "FT", "FEET"):
                    raise source.build_error(f"unit {word} is not supported; expected MM or INCHES", line)
                named.setdefault("mm" if word in ("MM", "METRIC") else "inch", line)
        if "MMP" in text and ("MMPM" in text or "MMPR" in text):
            feeds.setdefault("mm", line)
        if "IPM" in text or "IPR" in text:
            words = split_fields(text.partition("/")[2])
            if "IPM" in words or "IPR" in words:
                feeds.setdefault("inch", line)
    if len(named) == 2:
        feeds = {}  # each section names its own
    for where in (feeds,):
        if len(where) == 2:
            raise source.build_error(
                f"units mm (line {where['mm']}) and inch (line {where['inch']}) are mixed; expected one of them"
            )
    unit = next(iter(named), None) or next(iter(feeds), None)
    if unit is None and "*CATIA" in "\n".join(source.lines[:200]):
        unit = "mm"  # CATIA writes aptsource in mm whatever the session shows
    out.meta["unit_from"] = "UNITS" if named else "feed words" if feeds else "option"
    if unit is None:
        if options.unit is None:
            raise source.build_option_question(
                "unit", "does not state whether it is in mm or inch; give it with --unit mm or --unit inch"
            )
        unit = options.unit
    elif options.unit is not None and options.unit != unit and len(named) < 2:
        unit_line = (named or feeds).get(unit)
        raise source.build_error(f"the file is in {unit} but --unit {options.unit} was given", unit_line)
    out.meta["unit"] = unit
    return 1.0 if unit == "mm" else MM_PER_INCH
