"""Dwell units, seconds or milliseconds, by the control and the number format."""

from __future__ import annotations

import math
import re
from typing import Literal

from machopt.file_formats.source_file import SourceFile

Control = Literal["fanuc", "linuxcnc", ""]
MAX_DWELL_S = 300.0  # of a block; warming-up programs wait a few minutes
_LINUXCNC = re.compile(  # M428 to M430: switches of its five-axis kinematics
    r"#\s*<|^\s*O\s*(?:<|[0-9]+\s*(?:SUB|CALL|IF|DO|WHILE|REPEAT)\b)|^\s*M4(?:28|29|30)(?![0-9])",
    re.IGNORECASE | re.MULTILINE,
)
_FANUC = re.compile(r"^\s*[O:]\s*[0-9]+\s*(?:\(|;|$)|M9[89](?![0-9])|G65(?![0-9.])", re.IGNORECASE | re.MULTILINE)
_SURELY_MS = 100.0  # without a decimal point: no dwell in a hole takes minutes


def find_control(source: SourceFile) -> Control:
    """Detect the control by words that only one kind of control has, else by LinuxCNC's ending ``.ngc``.

    Args:
        source: Lines of the file, with its path and the builders of its errors.

    Returns:
        The control; empty where unknown.
    """
    if source.find_line(_LINUXCNC) is not None:
        return "linuxcnc"
    if source.find_line(_FANUC) is not None:
        return "fanuc"
    return "linuxcnc" if source.path.suffix.lower() == ".ngc" else ""


def convert_dwell(value: float, *, letter: str, bare: bool, control: Control) -> float:
    """Convert a dwell to seconds.

    With a decimal point, and on LinuxCNC, a dwell is in seconds. Without one P counts milliseconds on Fanuc and Haas.
    For X and U a parameter decides; the size of the number is used instead.

    Args:
        value: Number behind the letter.
        letter: P, X or U.
        bare: Whether the number has no decimal point.
        control: The control.

    Returns:
        Dwell in s; NaN where the unit is not known.
    """
    if value == 0.0 or not bare or control == "linuxcnc":
        return value
    if (control == "fanuc" and letter == "P") or value >= _SURELY_MS:
        return value / 1e3
    return math.nan
