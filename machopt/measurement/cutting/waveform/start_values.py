"""Start values: spindle speed, angular offset of each cut, coefficients, run-out.

The forces of a cut repeat with the rotation: the spindle speed maximises the power at the multiples of the rotation.
Folded over one revolution, a cut is some hundred means; offsets are found among the parts of the revolution, and the
coefficients of each by non-negative least squares. The run-out starts from several values.
"""

from __future__ import annotations

import math

import numpy as np

from machopt.data_types.measurements.waveform_recording import WaveformRecording
from machopt.measurement.cutting.waveform.waveform_model import COEFFICIENTS, MICRO, RUNOUT, WaveformModel
from machopt.numerics.array_types import Array

SPEED_RANGE = 0.02  # relative; slip of an asynchronous spindle is below
HARMONICS = 4  # of the tooth passing frequency, whose power is summed
PITCH_BINS = 36  # parts of a tooth pitch
RUNOUT_STARTS = (0.05, 0.4)  # of the feed per tooth


def find_spindle_speeds(recording: WaveformRecording, teeth: int, force: Array) -> Array:
    """Return the spindle speed of each cut, (C,) rev/s: the stated one with an encoder.

    Args:
        recording: Samples of all cuts.
        teeth: Number of teeth.
        force: (S, 3) N.
    """
    first = recording.first[:-1]
    stated = np.array(recording.samples.spindle_speed[first])
    if recording.time is None:
        return stated
    out = np.empty(recording.cuts)
    for n in range(recording.cuts):
        rows = recording.get_rows(n)
        time = recording.time[rows] - recording.time[rows.start]
        signal = force[rows] - force[rows].mean(axis=0)
        fine = 0.1 / (HARMONICS * teeth * time[-1])  # a tenth of the width of the highest line
        tried = np.arange(stated[n] * (1.0 - SPEED_RANGE), stated[n] * (1.0 + SPEED_RANGE), fine)
        tried = np.append(tried, stated[n])
        power = np.zeros(len(tried))
        for m in range(1, HARMONICS + 1):
            for start in range(0, len(tried), 256):
                some = tried[start : start + 256]
                wave = np.exp(-2j * math.pi * m * teeth * np.outer(some, time))
                power[start : start + 256] += np.sum(np.abs(wave @ signal) ** 2, axis=1)
        out[n] = tried[int(np.argmax(power))]
    return out


def find_start_values(model: WaveformModel) -> Array:
    """Return unknowns from which the fit converges, (P,).

    Args:
        model: Model of all samples.
    """
    from scipy.optimize import least_squares

    folded = model.fold(PITCH_BINS * model.teeth)
    lead = int(np.argmax([np.sum((cut.force - cut.force.mean(axis=0)) ** 2) for cut in folded.cuts]))
    one = WaveformModel((folded.cuts[lead],), model.teeth, has_own_offset=False)
    x = _find_offset(one)
    found, least = x, math.inf
    pitch = 2.0 * math.pi / model.teeth
    for share in RUNOUT_STARTS:
        for turned in (-pitch / 4.0, pitch / 4.0) if model.teeth > 1 else (0.0,):
            start = np.array(x)
            rho = share * folded.cuts[lead].feed_per_tooth / MICRO
            start[RUNOUT] = rho * math.cos(turned), rho * math.sin(turned)
            done = least_squares(
                lambda v: (one.evaluate(v, 0)[0] - one.cuts[0].force).ravel(),
                start,
                jac=lambda v: one.evaluate(v, 0)[1].reshape(-1, one.size),
                method="lm",
                x_scale="jac",
                max_nfev=40,
            )
            if done.cost < least:
                found, least = np.array(done.x), float(done.cost)
    return _spread_offset(model, folded, lead, found)


def _find_offset(one: WaveformModel) -> Array:
    """Return the unknowns of a folded cut without run-out, with the best offset within a pitch."""
    from scipy.optimize import nnls

    cut = one.cuts[0]
    bins = len(cut.rotation)
    x = np.zeros(one.size)
    x[0] = 1.0
    x[RUNOUT] = 1e-3, 0.0  # a nanometre: the derivative has one side at exactly zero
    design = one.evaluate(x, 0)[1][..., :COEFFICIENTS]
    scale = np.maximum(np.linalg.norm(design.reshape(-1, COEFFICIENTS), axis=0), 1e-12)
    best, least = np.zeros(COEFFICIENTS), math.inf
    for shift in range(bins // one.teeth):
        turned = np.roll(design, -shift, axis=0) / scale
        values, rest = nnls(turned.reshape(-1, COEFFICIENTS), cut.force.ravel())
        if rest < least:
            best, least = values / scale, rest
            x[8] = 2.0 * math.pi * shift / bins
    x[:COEFFICIENTS] = best
    return x


def _spread_offset(model: WaveformModel, folded: WaveformModel, lead: int, found: Array) -> Array:
    """Return the unknowns of all cuts: the other cuts get the best offset of a whole revolution."""
    x = np.zeros(model.size)
    x[: RUNOUT.stop] = found[: RUNOUT.stop]
    if not model.has_own_offset:
        x[8] = found[8]
        return x
    turn = 2.0 * math.pi
    for n, cut in enumerate(folded.cuts):
        one = WaveformModel((cut,), model.teeth, has_own_offset=False)
        bins = len(cut.rotation)
        wave = one.evaluate(np.append(found[: RUNOUT.stop], 0.0), 0)[0]
        misfit = [float(np.sum((np.roll(wave, -shift, axis=0) - cut.force) ** 2)) for shift in range(bins)]
        x[8 + n] = found[8] if n == lead else turn * int(np.argmin(misfit)) / bins
    return x
