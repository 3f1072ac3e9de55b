"""Link of an inclinometer: key ``tilt_link`` of recording.yaml, together with the columns tilt_x_mrad, tilt_y_mrad."""

from __future__ import annotations

import numpy as np

from machopt.data_types.measurements.recording import RecordingKind
from machopt.file_formats.strict_yaml import YamlDocument, format_found_value
from machopt.measurement.recording.recording_columns import TILTS
from machopt.measurement.recording.recording_table import RecordingTable

KEY = "tilt_link"


def parse_tilt_link(document: YamlDocument, given: object, kind: RecordingKind) -> str:
    """Parse the link named in recording.yaml.

    Args:
        document: The file recording.yaml, for error messages.
        given: Link name of the URDF, or the number of the joint that moves it (0: the base).
        kind: Kind of the recording.

    Returns:
        The link; empty if none is named.

    Raises:
        InputError: Another kind of recording, or neither a name nor a whole number.
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
    """Check that tilts and their link are both present, and that no column is empty.

    Args:
        table: Table of one data file.
        link: Link named in recording.yaml; empty if none.

    Raises:
        InputError: Names the file and what is missing.
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
