"""Checks of a waveform recording before the fit: length, sampling rate, and the samples that are used."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, pi

import numpy as np

from machopt.data_types.measurements.waveform_recording import WaveformRecording
from machopt.errors import CuttingInputError, RecordingError
from machopt.numerics.array_types import Array
from machopt.process.milling.milling_cut import CutSide, MillingCut, MillingCutter, check_cut_dimensions

FEWEST_REVOLUTIONS = 4  # run-out and noise are distinguished by what repeats, three times or more
FEWEST_PER_TOOTH = 8  # samples of a tooth pass: four harmonics below half the sampling rate
MOST_SAMPLES = 12_000  # of all cuts together: more takes minutes; intervals of a percent need a thousand


def check_waveforms(recording: WaveformRecording, cutter: MillingCutter) -> None:
    """Refuse cuts that are too short, sampled too slowly, or impossible with this cutter.

    Args:
        recording: Samples of all cuts.
        cutter: Flat end mill.

    Raises:
        RecordingError: names file, line, what was found and what is expected.
        CuttingInputError: an impossible cut.
    """
    one = recording.samples
    if cutter.corner_radius > 0.0:
        raise CuttingInputError(
            f"the cutter has a corner radius of {1e3 * cutter.corner_radius:g} mm; waveforms are fitted for flat end "
            "mills (corner_radius_mm 0)",
            key="corner_radius_mm",
        )
    for n in range(recording.cuts):
        rows = recording.get_rows(n)
        row = rows.start
        place = f"lines {one.line[row]} to {one.line[rows.stop - 1]}"
        step = _compute_rotation_step(recording, n)
        turns = step * (rows.stop - rows.start) / (2.0 * pi)
        per_tooth = 2.0 * pi / (step * cutter.teeth)
        if turns < FEWEST_REVOLUTIONS:
            raise RecordingError(
                f"found {turns:.2g} revolutions ({turns * cutter.teeth:.2g} tooth passes); expected "
                f"{FEWEST_REVOLUTIONS} revolutions or more of a cut",
                file=one.files[one.file[row]],
                where=place,
            )
        if per_tooth < FEWEST_PER_TOOTH:
            raise RecordingError(
                f"found {per_tooth:.2g} samples for each tooth pass ({cutter.teeth} teeth at "
                f"{60.0 * one.spindle_speed[row]:g} rpm): aliasing; expected {FEWEST_PER_TOOTH} or more",
                file=one.files[one.file[row]],
                where=place,
            )
        side: CutSide = one.side[row]
        ae = cutter.diameter if side == "slot" and np.isnan(one.ae[row]) else one.ae[row]
        check_cut_dimensions(cutter, MillingCut(side, one.spindle), np.array([ae]), one.ap[row : row + 1])
        if not (ae > 0.0 and one.ap[row] > 0.0):
            raise RecordingError(
                "nothing is cut: ae or ap is 0; expected more", file=one.files[one.file[row]], where=place
            )


def _compute_rotation_step(recording: WaveformRecording, cut: int) -> float:
    """Return the rotation between two samples, rad."""
    rows = recording.get_rows(cut)
    if recording.angle is not None:
        return float(np.median(np.diff(recording.angle[rows])))
    assert recording.time is not None
    return float(np.median(np.diff(recording.time[rows])) * 2.0 * pi * recording.samples.spindle_speed[rows.start])


def limit_samples(recording: WaveformRecording, force: Array, teeth: int) -> tuple[WaveformRecording, Array]:
    """Return the first revolutions of each cut, so that the fit takes seconds; a warning says so.

    Args:
        recording: Samples of all cuts.
        force: (S, 3) N.
        teeth: Number of teeth.

    Returns:
        The recording and the forces, unchanged where they are few.
    """
    total = len(force)
    if total <= MOST_SAMPLES:
        return recording, force
    selected, first = [], [0]
    for n in range(recording.cuts):
        rows = recording.get_rows(n)
        per_turn = 2.0 * pi / _compute_rotation_step(recording, n)
        share = MOST_SAMPLES * (rows.stop - rows.start) / total
        count = min(rows.stop - rows.start, ceil(max(share, FEWEST_REVOLUTIONS * per_turn + teeth)))
        selected.append(np.arange(rows.start, rows.start + count))
        first.append(first[-1] + count)
    used = np.concatenate(selected)
    text = f"the first {len(used)} of {total} samples are used, the same share of each cut"
    one = recording.samples
    samples = replace(
        one,
        file=one.file[used],
        line=one.line[used],
        spindle_speed=one.spindle_speed[used],
        feed=one.feed[used],
        ae=one.ae[used],
        ap=one.ap[used],
        side=tuple(one.side[n] for n in used),
        force=one.force[used],
        travel=None if one.travel is None else one.travel[used],
        q=None if one.q is None else one.q[used],
        warnings=(*one.warnings, text),
    )
    cut_short = replace(
        recording,
        samples=samples,
        first=np.array(first, dtype=np.int64),
        time=None if recording.time is None else recording.time[used],
        angle=None if recording.angle is None else recording.angle[used],
    )
    return cut_short, force[used]
