"""Which scanner a file belongs to: by its ending and its first telling line."""

from __future__ import annotations

import re
from pathlib import Path

from second_cam_reader import apt, gcode, heidenhain, robot_programs
from second_cam_reader.sampled_path import NotReadError, Path3


def reader_for(file: Path, text: str) -> Path3:
    """Read ``text`` by the scanner that fits."""
    end, head = file.suffix.lower(), text[:20000].upper()
    if end in (".p21", ".stp") or "ISO-10303" in head:
        raise NotReadError("STEP-NC holds features, no points")
    if end == ".script":
        return robot_programs.urscript(text)
    if re.search(r"^\s*MODULE\s|^\s*MODULE\s*\w+\(", head, re.M) or end in (".mod", ".prg"):
        return robot_programs.rapid(text)
    if end in (".src", ".dat") or head.lstrip().startswith(("DEF ", "&ACCESS")):
        return robot_programs.krl(text, beside(file, ".dat") if end == ".src" else "")
    if "/PROG" in head and "/MN" in text:
        return robot_programs.fanuc(text)
    if head.lstrip().startswith("/JOB"):
        return robot_programs.jbi(text)
    if re.search(r"BEGIN PGM", head):
        return heidenhain.read(text)
    if re.search(r"^%\s*\d+\s+G7[01]", head, re.M):
        raise NotReadError("Heidenhain ISO")
    if (
        "CATIA0" in head
        or "CATIA APT" in head
        or re.search(r"^\s*(TOOL PATH|PARTNO|UNITS?|GOTO\s*|RAPID/)", head, re.M)
    ):
        return apt.read(text)
    siemens = end in (".mpf", ".spf") or re.search(r"CYCLE8|TRAORI|CR=|MCALL|=AC\(", head) is not None
    return gcode.read(text, "siemens" if siemens else "gcode")


def beside(file: Path, suffix: str) -> str:
    """Text of the file of the same name with another ending, or nothing."""
    other = file.with_suffix(suffix)
    return other.read_text(encoding="latin-1") if other.exists() else ""
