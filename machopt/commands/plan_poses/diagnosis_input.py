"""Diagnosis that ``plan-poses --discriminate`` starts from."""

from __future__ import annotations

from os.path import isdir, isfile
from pathlib import Path

from machopt.data_types.documents.diagnosis_document import DiagnosisDocument
from machopt.errors import InputError
from machopt.measurement.diagnosis.discrimination.open_hypotheses import OpenDiagnosis, read_open_diagnosis
from machopt.output import read_result


def read_diagnosis(folder: Path) -> OpenDiagnosis:
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
        data = read_result(file, DiagnosisDocument)
    except InputError as problem:
        raise InputError(f"{problem.reason}; a fresh machopt diagnose writes what a plan needs", file=file) from None
    return read_open_diagnosis(data, file)
