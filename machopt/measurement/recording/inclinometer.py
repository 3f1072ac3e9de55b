"""Which link an inclinometer sits on: ``tilt_link`` of recording.yaml, beside the columns tilt_x_mrad, tilt_y_mrad."""

from __future__ import annotations

import numpy as np

from machopt.data_types.measurements.recording import RecordingKind
from machopt.file_formats.strict_yaml import YamlDocument, format_found_value
from machopt.measurement.recording.recording_columns import TILTS
from machopt.measurement.recording.recording_table import RecordingTable

KEY = "tilt_link"


def parse_tilt_link(document: YamlDocument, given: object, kind: RecordingKind) -> str:
    """The link that recording.yaml names; empty where it names none.

    Args:
        given: name of a link of the URDF, or the number of the joint that moves it (0: the base).

    Raises:
        InputError: another kind of recording, or neither a name nor a whole number.
    """
    if given is None:
        return ""
    if kind != "absolute":
        raise document.build_error((KEY,), f"belongs to recordings of kind absolute; found {kind}")
    whole = isinstance(given, int) and not isinstance(given, bool)
    if not whole and not (isinstance(given, str) and given.strip()):
        raise document.build_error(
            (KEY,),
            f"found {format_found_value(given)}; expected a link of the URDF, or the number of the joint that moves it",
        )
    return str(given).strip()


def check_tilt_columns(table: RecordingTable, link: str) -> None:
    """Refuse tilts of no link, a link without tilts, and columns that are empty altogether.

    Raises:
        InputError: names the file and what is missing.
    """
    there = [name for name in TILTS if name in table.numbers]
    if there and not link:
        raise table.build_error(
            f"column {there[0]} needs {KEY} in recording.yaml, the link that the inclinometer sits on"
        )
    if link and not there:
        raise table.build_error(f"columns {', '.join(TILTS)} are missing; recording.yaml names {KEY} {link}")
    for name in there:
        if np.isnan(table.numbers[name]).all():
            raise table.build_error("holds no number; expected one where the inclinometer was read", column=name)
