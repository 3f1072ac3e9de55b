"""Columns of force waveforms in a recording of measured cuts: samples in order, cuts, even spacing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.data_types.measurements.cutting_recording import CuttingRecording
from machopt.data_types.measurements.waveform_recording import WaveformRecording
from machopt.measurement.recording.recording_table import RecordingTable
from machopt.numerics.array_types import Array

ABSCISSAS = ("time_s", "angle_deg")
CUT_NUMBER = "cut_number"
CONDITIONS = ("spindle_rpm", "feed_mm_min", "ae_mm", "ap_mm")
UNEVEN = 0.05  # of a step: rounding of a time stamp to three digits of a step, not a lost sample


def find_abscissa(tables: Sequence[RecordingTable]) -> str | None:
    """Return the column over which forces are resolved; None: one row is the mean of a cut.

    Args:
        tables: data files with the same columns.

    Raises:
        RecordingError: both columns, or a cut number without either.
    """
    first = tables[0]
    found = [name for name in ABSCISSAS if name in first.numbers]
    if len(found) == 2:
        raise first.build_error("has columns time_s and angle_deg; expected one of them")
    if not found and CUT_NUMBER in first.numbers:
        raise first.build_error("has a column cut_number, but neither time_s nor angle_deg, of which one makes it work")
    return found[0] if found else None


def build_waveform_recording(
    samples: CuttingRecording, tables: Sequence[RecordingTable], abscissa: str
) -> WaveformRecording:
    """Return the waveforms; a data file without cut numbers is one cut.

    Args:
        samples: all rows as cuts.
        tables: data files.
        abscissa: time_s or angle_deg.

    Raises:
        RecordingError: changed conditions within a cut, samples out of order or unevenly spaced, cut numbers that
            come again.
    """
    first = [0]
    for table in tables:
        starts = _find_starts(table)
        for start, stop in zip(starts, [*starts[1:], len(table)], strict=True):
            _check_cut(table, slice(start, stop), abscissa)
            first.append(first[-1] + stop - start)
    values = np.concatenate([t.numbers[abscissa] for t in tables])
    return WaveformRecording(
        samples=samples,
        first=np.array(first, dtype=np.int64),
        time=np.array(values) if abscissa == "time_s" else None,
        angle=np.radians(values) if abscissa == "angle_deg" else None,
    )


def _find_starts(table: RecordingTable) -> list[int]:
    if CUT_NUMBER not in table.numbers:
        return [0]
    number: Array = table.numbers[CUT_NUMBER]
    fraction = np.flatnonzero(number != np.floor(number))
    if fraction.size:
        row = int(fraction[0])
        raise table.build_error(f"found {number[row]:g}; expected a whole number", row, CUT_NUMBER)
    starts = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist()]
    for k, start in enumerate(starts):
        if number[start] in number[starts[:k]]:
            raise table.build_error(
                f"cut {number[start]:g} comes again; expected the samples of a cut in consecutive rows",
                start,
                CUT_NUMBER,
            )
    return starts


def _check_cut(table: RecordingTable, rows: slice, abscissa: str) -> None:
    hint = "one cut number for each cut, or one file for each, would work"
    for name in CONDITIONS:
        values = table.numbers.get(name)
        if values is None:
            continue
        changed = np.flatnonzero((values[rows] != values[rows.start]) & ~np.isnan(values[rows]))
        if changed.size:
            row = rows.start + int(changed[0])
            raise table.build_error(
                f"found {values[row]:g} after {values[rows.start]:g}; expected the same within a cut ({hint})",
                row,
                name,
            )
    for k, word in enumerate(table.words.get("cut", [])[rows]):
        if word != table.words["cut"][rows.start]:
            raise table.build_error(
                f"found {word!r}; expected the same side within a cut ({hint})", rows.start + k, "cut"
            )
    steps = np.diff(table.numbers[abscissa][rows])
    if not steps.size:
        raise table.build_error("is the only sample of its cut; expected several revolutions", rows.start, abscissa)
    usual = float(np.median(steps))
    bad = np.flatnonzero(~(steps > 0.0) | (np.abs(steps - usual) > UNEVEN * usual))
    if bad.size:
        row = rows.start + int(bad[0]) + 1
        found = table.numbers[abscissa]
        raise table.build_error(
            f"found {found[row]:.9g} after {found[row - 1]:.9g}; expected even steps of {usual:.4g} in ascending order "
            f"({hint}; a filled gap or a resampled signal would, too)",
            row,
            abscissa,
        )
