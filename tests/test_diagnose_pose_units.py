"""Units of measured poses: of all sessions, of one session, of angles and lengths together."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from test_diagnose_tcp_poses import arm, measure

from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.data_quality import pose_units
from machopt.measurement.diagnosis.diagnosis_pipeline import DiagnosedRecording
from machopt.measurement.diagnosis.outputs.model_uncertainty import estimate_position_error
from machopt.numerics.rigid_transforms import convert_vector_to_rotation

ANGLES = {"radians": np.degrees(1.0), "turns": 360.0, "gon": 0.9}
LENGTHS = {"metres": 1e3, "inches": 25.4}


def simulate_correct_poses(*, fit: bool) -> Recording:
    """Simulate poses from a tracker in the hall (``fit``) or in base_link; noise 30 µm, links longer than nominal."""
    r = measure(noise=3e-5, grow=np.full((180, 3), 5e-4), registration="fit" if fit else "fixed")
    if not fit:
        return r
    assert r.position is not None
    return replace(r, position=r.position @ convert_vector_to_rotation(np.array([0.3, -1.9, 1.0])).T + [2.0, -3.0, 0.4])


@pytest.mark.parametrize("fit", [True, False])
@pytest.mark.parametrize("hit", [(0, 1, 2), (1,)])
@pytest.mark.parametrize(
    ("angle", "length"), [*((a, "") for a in ANGLES), *(("", n) for n in LENGTHS), ("turns", "inches")]
)
def test_unit_is_identified_by_the_best_fit(fit: bool, hit: tuple[int, ...], angle: str, length: str) -> None:
    cell, robot, _ = arm()
    T = cell.tool.T_flange_tcp
    right = simulate_correct_poses(fit=fit)
    rows = np.isin(right.session, hit)
    q, x = right.q.copy(), np.array(right.position)
    q[rows] /= ANGLES.get(angle, 1.0)
    x[rows] /= LENGTHS.get(length, 1.0)
    read, findings = pose_units.correct_pose_units(replace(right, q=q, position=x), robot, T)
    np.testing.assert_allclose(read.q, right.q, rtol=1e-12)
    np.testing.assert_allclose(np.array(read.position), np.array(right.position), rtol=1e-12)
    columns = (["column:q1_deg"] if angle else []) + (["column:x_mm"] if length else [])
    assert [f.location for f in findings] == columns
    assert all(f.record and f.effect == "units" for f in findings)
    for f, factor in zip(findings, [v for v in (ANGLES.get(angle), LENGTHS.get(length)) if v], strict=True):
        assert f.parameters["factor"].value == pytest.approx(1.0 / factor)
        assert ("session" in f.parameters) == (len(hit) == 1)
        assert f.after < 0.5 * f.before
    retained, none = pose_units.correct_pose_units(replace(right, q=q, position=x), robot, T, ("units",))
    assert not none
    assert retained.q is q


@pytest.mark.parametrize("fit", [True, False])
@pytest.mark.parametrize("hit", [(0, 1, 2), (2,)])
@pytest.mark.parametrize(("joint", "angle"), [(4, "radians"), (0, "radians"), (3, "turns")])
def test_single_joint_with_another_unit_is_identified(fit: bool, hit: tuple[int, ...], joint: int, angle: str) -> None:
    cell, robot, _ = arm()
    right = simulate_correct_poses(fit=fit)
    q = right.q.copy()
    q[np.isin(right.session, hit), joint] /= ANGLES[angle]
    read, (finding,) = pose_units.correct_pose_units(replace(right, q=q), robot, cell.tool.T_flange_tcp)
    np.testing.assert_allclose(read.q, right.q, rtol=1e-12)
    assert finding.location == f"column:q{joint + 1}_deg"
    assert f"the column q{joint + 1}_deg holds {angle}" in finding.note


def test_correct_recording_and_wrong_tcp_remain() -> None:
    cell, robot, _ = arm()
    T = cell.tool.T_flange_tcp.copy()
    for wrong in (0.0, 0.15):
        T[:3, 3] += wrong
        right = simulate_correct_poses(fit=True)
        assert pose_units.correct_pose_units(right, robot, T) == (right, [])


def test_residual_pose_errors_are_written_with_their_joint_ranges() -> None:
    """Only readings used in the fit count; the error is per coordinate; too few poses give none."""
    r = simulate_correct_poses(fit=False)
    used = np.arange(len(r)) != 7
    left = np.full((len(r), 3), 2e-5)
    left[7] = 1.0
    errors = SimpleNamespace(residual=10 * left, final=left)
    d = SimpleNamespace(errors=errors, used=used, noise_floor=0.015)
    found = estimate_position_error(cast("DiagnosedRecording", SimpleNamespace(diagnosis=d, recording=r)))
    assert found is not None
    assert (found.std, found.plain, found.noise) == pytest.approx((2e-5, 2e-4, 1.5e-5))
    assert found.poses == 60
    np.testing.assert_array_equal(found.joints, np.stack([r.q[used].min(axis=0), r.q[used].max(axis=0)], axis=1))
    d.used = r.pose < 5
    assert estimate_position_error(cast("DiagnosedRecording", SimpleNamespace(diagnosis=d, recording=r))) is None
