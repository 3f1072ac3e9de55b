"""Waves of few periods or implausible amplitude are corrections without a name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machopt.cell.kinematics_file import load_kinematics, write_kinematics
from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.kinematics.encoder_corrections import build_encoder_correction
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding
from machopt.measurement.diagnosis.verdict.transmission_error_naming import (
    convert_to_unnamed,
    is_constant_of_unnamed_waves,
    split_waves,
)
from machopt.numerics.array_types import Array
from machopt.verification.motion.kinematics.encoder_correction import compute_true_angles

RANGE = [-60.0, 90.0]


def finding(orders: list[float], cos: list[float], sin: list[float]) -> Finding:
    sizes = np.hypot(cos, sin)
    parameters: dict[str, EstimatedValue] = {}
    for word, k in zip(("", "second_", "third_"), np.argsort(-sizes).tolist(), strict=False):
        for key, value in (("amplitude", float(sizes[k])), ("order", orders[k])):
            parameters[word + key] = EstimatedValue(value, "", (value, value), (value, value))
    return Finding(
        effect="transmission_error",
        location="joint:3",
        law="waves",
        equation="",
        note="",
        one_of=(("transmission_error", "joint:3"),),
        parameters=parameters,
        before=1.0,
        after=0.5,
        p_value=0.001,
        correction=KinematicCorrection(
            "transmission_error",
            "joint:3",
            {"per_turn": orders, "cos_arcsec": cos, "sin_arcsec": sin, "range_deg": RANGE},
        ),
    )


def angles(*parts: Finding | None) -> Array:
    q = np.zeros((200, 6))
    q[:, 2] = np.radians(np.linspace(-75.0, 100.0, 200))
    entries = [p.correction for p in parts if p is not None]
    made = build_encoder_correction(
        KinematicCorrections(tuple(c for c in entries if isinstance(c, KinematicCorrection)))
    )
    assert made is not None
    return made.compute_correction(q)[:, 2]


@pytest.mark.parametrize(
    ("orders", "sizes", "named"),
    [
        ([1.0, 2.0, 12.0], [40.0, 20.0, 15.0], [12.0]),  # range 150 degrees: less than one period of the first two
        ([2.0, 4.0, 9.0], [10.0, 30.0, 20.0], [4.0, 9.0]),  # 0.83, 1.67 and 3.75 periods
        ([10.0, 20.0, 30.0], [15.0, 700.0, 5.0], [10.0, 30.0]),  # 700 arcsec is implausible for a gear
        ([1.0, 4.0, 12.0], [250.0, 250.0, 250.0], [12.0]),  # a worn gear; five periods are observed
    ],
)
def test_only_waves_of_a_full_period_and_plausible_size_are_named(
    orders: list[float], sizes: list[float], named: list[float]
) -> None:
    whole = finding(orders, [0.6 * v for v in sizes], [-0.8 * v for v in sizes])
    parts = split_waves(whole)
    assert parts.named is not None
    assert parts.unnamed is not None
    assert isinstance(parts.named.correction, KinematicCorrection)
    assert isinstance(parts.unnamed.correction, KinematicCorrection)
    assert parts.named.correction.parameters["per_turn"] == named
    assert parts.unnamed.correction.effect == "kinematic_correction"
    assert sorted(parts.unnamed.correction.parameters["orders"] + named) == orders
    found = [e.value for key, e in parts.named.parameters.items() if key.endswith("order")]
    assert sorted(found) == named
    np.testing.assert_allclose(angles(parts.named, parts.unnamed), angles(whole), atol=1e-15)


def test_waves_of_a_gravity_compensator_keep_its_name() -> None:
    slow = replace(finding([1.0, 2.0, 3.0], [900.0, -120.0, 40.0], [80.0, 300.0, -6.0]), effect="gravity_compensator")
    assert split_waves(slow).named is slow
    assert split_waves(slow).unnamed is None


def test_slow_waves_are_not_named() -> None:
    parts = split_waves(finding([1.0, 2.0], [30.0, 10.0], [0.0, 5.0]))
    assert parts.named is None
    assert parts.unnamed is not None


def test_zero_offset_smaller_than_unnamed_waves_of_its_joint_has_no_name() -> None:
    waves = convert_to_unnamed(finding([3.0], [34.0], [-20.0]))  # amplitude 39 arcsec

    def zero(arcsec: float, joint: str = "joint:3") -> Finding:
        correction = KinematicCorrection("joint_zero_offset", joint, {"offset_deg": arcsec / 3600.0})
        return replace(finding([3.0], [1.0], [1.0]), effect="joint_zero_offset", correction=correction)

    assert is_constant_of_unnamed_waves(zero(-30.0), [waves])
    assert not is_constant_of_unnamed_waves(zero(-50.0), [waves])
    assert not is_constant_of_unnamed_waves(zero(-30.0, "joint:2"), [waves])
    assert not is_constant_of_unnamed_waves(zero(-30.0), [])
    assert not is_constant_of_unnamed_waves(waves, [waves])
    fast = convert_to_unnamed(finding([5.0], [40.0], [0.0]))  # 2.1 periods in the range of 150°
    assert not is_constant_of_unnamed_waves(zero(-30.0), [fast])


def test_file_planner_and_verification_apply_the_same_angles(tmp_path: Path) -> None:
    one = convert_to_unnamed(finding([1.0, 2.0, 5.0], [30.0, -12.0, 4.0], [8.0, 3.0, -6.0]))
    assert isinstance(one.correction, KinematicCorrection)
    write_kinematics(tmp_path / "kinematics.yaml", KinematicCorrections((one.correction,)))
    read = load_kinematics(tmp_path / "kinematics.yaml")
    made = build_encoder_correction(read)
    assert made is not None
    q = np.random.default_rng(3).uniform(-2.0, 2.0, (300, 6))
    np.testing.assert_allclose(made.compute_true_angles(q), compute_true_angles(read, q), atol=1e-12)
    assert np.abs(made.compute_correction(q)[:, 2]).max() > 1e-5
