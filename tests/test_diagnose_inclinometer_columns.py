"""Inclinometer columns in other conventions, on the base and the first link."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_diagnose_inclinometer import ROCKS, simulate_recording
from test_diagnose_tcp_poses import arm

from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.data_quality import exchanged_inclinometer_columns
from machopt.measurement.diagnosis.static import inclinometer_equations


def read(recording: Recording, tilt: np.ndarray, *accept: str) -> tuple[Recording, list[tuple[str, str]]]:
    cell, robot, masses = arm()
    out, findings = exchanged_inclinometer_columns.correct_inclinometer_columns(
        replace(recording, tilt=tilt), cell, robot, masses, accept
    )
    assert all(f.record for f in findings)
    return out, [(f.effect, f.location) for f in findings]


@pytest.mark.parametrize("link", [0, 1, 3])
def test_columns_in_other_conventions_are_corrected(link: int) -> None:
    recording = simulate_recording(rocks=ROCKS, noise=3e-5, tilt_noise=1e-5, link=link)
    right = np.array(recording.tilt)
    assert read(recording, right)[1] == []
    ways = {
        "exchanged": right[:, ::-1],
        "x reversed": right * [-1.0, 1.0],
        "both reversed": -right,
        "exchanged and y reversed": right[:, ::-1] * [1.0, -1.0],
    }
    for words, written in ways.items():
        out, found = read(recording, written)
        assert found == [("columns", "column:tilt_x_mrad")], words
        np.testing.assert_array_equal(out.tilt, right, words)
        assert read(recording, written, "columns")[1] == []
    for unit in ("degrees", "arcsec"):
        out, found = read(recording, right * inclinometer_equations.UNITS[unit])
        assert found == [("units", "column:tilt_x_mrad")], unit
        np.testing.assert_allclose(np.array(out.tilt), right, rtol=1e-12)


def test_tilts_not_caused_by_weight_are_left_to_the_search() -> None:
    recording = simulate_recording(noise=3e-5, tilt_noise=1e-5, link=1)
    right = np.array(recording.tilt)
    assert read(recording, right)[1] == []  # noise only
    assert read(recording, right + 2e-4 * np.sin(7.0 * recording.q[:, [4, 5]]))[1] == []
    cell, robot, _ = arm()
    assert exchanged_inclinometer_columns.correct_inclinometer_columns(recording, cell, robot, None) == (recording, [])
