"""Diagnosis in memory, without output files, for tests of findings only.

The command also writes tables and pages, and recomputes its errors from the written files, which takes a quarter of the
time.
"""

from __future__ import annotations

from pathlib import Path

from machopt.commands.diagnose.computation import DiagnoseComputation
from machopt.commands.diagnose.run import compute_diagnosis
from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.request import DiagnoseRequest
from machopt.measurement.recording import write_recording


def diagnose_in_memory(cell: Path, recording: Recording, folder: Path) -> DiagnoseComputation:
    """Write the recording to a folder, read it like the command, and diagnose it."""
    write_recording(folder, recording)
    return compute_diagnosis(
        DiagnoseRequest(cell=cell, recordings=(folder,), out=folder / "no_out"), (), lambda _: None
    )
