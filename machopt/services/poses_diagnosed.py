"""The diagnosis that ``plan-poses --discriminate`` starts from."""

from __future__ import annotations

from os.path import isdir, isfile
from pathlib import Path

from machopt.diagnose.apart.disputes import Diagnosed, left_open
from machopt.domain.results.diagnosis import DiagnosisResult
from machopt.errors import InputError
from machopt.output import read_result


def diagnosed(folder: Path) -> Diagnosed:
    """Read ``diagnosis.json``.

    Args:
        folder: what ``machopt diagnose`` wrote, or the file itself.

    Raises:
        InputError: no diagnosis, one of a motion, or one of another version.
    """
    file = folder / "diagnosis.json" if isdir(folder) else folder
    if not isfile(file):
        raise InputError("there is no such file; the folder that machopt diagnose wrote would work", file=file)
    try:
        data = read_result(file, DiagnosisResult)
    except InputError as problem:
        raise InputError(f"{problem.reason}; a fresh machopt diagnose writes what a plan needs", file=file) from None
    return left_open(data, file)
