"""Angle-dependent joint stiffness is named only where it is physically plausible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_diagnose_load_test_drift import build_timed_readings

from machopt.effects.joint import angle_dependent_stiffness
from machopt.measurement.diagnosis.effect_columns import joint_torque


@pytest.mark.parametrize(
    ("extra", "built"),
    [(0.0, True), (0.3, True), (1.2, True), (6.0, False), (284.0, False), (-0.5, True), (-1.2, False), (-2.5, False)],
)
def test_angle_dependent_stiffness_needs_a_compliant_joint_and_a_moderate_variation(extra: float, built: bool) -> None:
    """A nearly rigid joint was ``explained`` by an angle-dependent stiffness that varies by thousands of percent."""
    r, _, _ = build_timed_readings()
    laws = {h.law: h for h in joint_torque.build_joint_hypotheses(r, 1, angle_dependent_stiffness.EFFECT)[0]}
    q = np.quantile(r.state.q[:, 1], [0.02, 0.98])
    sector = laws["soft sector"]
    middle = min(sector.shapes, key=lambda s: abs(s[0] - q.mean()))
    assert sector.is_plausible(extra * r.compliance[1:2], middle) is built
    even = np.array([0.3, 0.0])  # a cosine of the angle
    if built:
        assert laws["one harmonic"].is_plausible(extra * even * r.compliance[1], ())


def test_variation_is_relative_to_the_mean_compliance() -> None:
    """The joint spring may be refitted to zero next to an angle-dependent law; relative to that value, a true
    variation was reported as 7,558 %."""
    r, _, _ = build_timed_readings()
    rest = replace(r, compliance=np.where(np.arange(6) == 1, 0.0, r.compliance), springs_only_compliance=r.compliance)
    x = np.array([0.2 * r.compliance[1]])
    sizes = []
    for readings in (r, rest):
        (sector,) = [
            h
            for h in joint_torque.build_joint_hypotheses(readings, 1, angle_dependent_stiffness.EFFECT)[0]
            if h.law == "soft sector"
        ]
        sizes.append(sector.quantities(x, sector.shapes[6])["variation"].value)
    assert sizes == pytest.approx([10.0, 10.0])
