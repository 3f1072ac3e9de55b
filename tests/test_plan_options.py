"""Planning options: units, layers, refusals."""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from math import pi, radians
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.data_types.plan_options import (
    ExternalJointOptions,
    FixedRotation,
    ObjectiveWeights,
    PlanOptions,
    ProcessForce,
    SteeringRule,
    TiltRange,
)
from machopt.errors import InputError
from machopt.options.option_schema import OptionKeys
from machopt.options.plan_option_reader import OPTIONS, find_options_without_effect, format_user_options, load_options


def test_no_layer_gives_the_default_options() -> None:
    assert load_options() == PlanOptions()


def flatten_options(options: PlanOptions) -> dict[str, object]:
    """Return every number and word by its dotted key (``force.travel: 10``), including nested ones."""
    out: dict[str, object] = {}

    def walk(name: str, value: object) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                walk(f"{name}.{key}", inner)
        elif isinstance(value, tuple):
            walk(name, dict(enumerate(value)))
        else:
            out[name] = value

    walk("", asdict(options))
    return out


def test_every_option_converts_to_user_form_and_back() -> None:
    """Each field with a non-default value survives PlanOptions → user → PlanOptions."""
    other = PlanOptions(
        objective="tolerance",
        method="jiao2022",
        index="deflection",
        force=ProcessForce(10, 20, 30),
        weights=ObjectiveWeights(mean=2, worst=3, travel=4, rotation=5, clearance=0.0),
        rotation_step=radians(2.5),
        rotation_range=(-pi / 2, pi / 3),
        preferred_rotation=radians(15),
        preferred_weight=0.7,
        fixed=(FixedRotation(3, radians(45)),),
        steer=(
            SteeringRule(operation="face", points=None, gamma=radians(30)),
            SteeringRule(points=(4, 4), forbid=(radians(170), radians(-170))),
            SteeringRule(points=(4, 9), prefer=radians(-20), weight=0.4),
            SteeringRule(branch=3),
        ),
        singularity_wrist=radians(7),
        singularity_elbow=radians(8),
        singularity_shoulder=0.12,
        limit_margin=radians(2),
        min_stability_ratio=1.25,
        advised_feed_share=0.5,
        clearance=0.011,
        clearance_full=0.13,
        collision_step=radians(0.7),
        collision=False,
        gouge=0.0004,
        sample=0.004,
        path_tolerance=33e-6,
        axis_tolerance=radians(0.21),
        approach_feed=0.07,
        rapid_scale=0.31,
        rapid_blend=0.007,
        limit_scale=0.47,
        allow_gaps=True,
        max_reentries=2,
        compensate=True,
        compensation_max=0.003,
        seed=9,
        tilt=TiltRange(lead=(radians(-5), radians(5)), side=(0.0, radians(3))),
        tilt_operations=(("face", TiltRange(side=(radians(-2), radians(2)))),),
        external=(
            ExternalJointOptions(
                joint="e1",
                mode="locked",
                operations=(("face", "operation"),),
                weight=0.5,
                at=1.25,
                preferred=0.25,
                range=(0.125, 2.5),
                unit="mm",
                at_operations=(("face", 0.75),),
            ),
            ExternalJointOptions(
                joint="turn",
                mode="moving",
                operations=(),
                weight=1.5,
                at=0.1,
                preferred=0.2,
                range=(-1.0, 1.0),
                unit="deg",
            ),
        ),
    )
    same = [f.name for f in fields(other) if getattr(other, f.name) == getattr(PlanOptions(), f.name)]
    assert same == []  # a new option must also be added above
    user = format_user_options(other)
    assert set(user) == set(OptionKeys.model_fields) - {"machopt_plan"}
    back = load_options(user)
    # user numbers are rounded to 12 significant digits
    found, expected = flatten_options(back), flatten_options(other)
    words = {name for name, value in expected.items() if value is None or isinstance(value, str)}
    assert {n: found.pop(n) for n in words} == {n: expected.pop(n) for n in words}
    assert found == pytest.approx(expected, rel=1e-11)


@settings(max_examples=scale_example_count(50), deadline=None)
@given(
    step=st.floats(0.5, 90).map(lambda v: round(v, 3)),
    clearance=st.floats(0, 500).map(lambda v: round(v, 3)),
    feed=st.floats(0.001, 120_000).map(lambda v: round(v, 3)),
)
def test_user_numbers_are_written_as_given(step: float, clearance: float, feed: float) -> None:
    user: dict[str, object] = {"rotation_step_deg": step, "clearance_mm": clearance, "approach_feed_mm_min": feed}
    shown = format_user_options(load_options(user))
    assert {k: shown[k] for k in user} == user


def test_later_layers_override_and_mappings_merge(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text("machopt_plan: 1\nrotation_step_deg: 4\nforce_N: {normal: 2}\nseed: 1\nclearance_mm: 3\n")
    options = load_options(
        {"rotation_step_deg": 3, "force_N": {"travel": 1, "normal": 1}, "sample_ms": 4, "seed": 0},
        file,
        ["force_N.axial=2e2", "weights={mean: 2}", "clearance_mm = 5", "fixed=[{point: 3, gamma_deg: 90}]"],
        seed=7,
        method=None,
    )
    assert options.force == ProcessForce(1, 2, 200)
    assert options.weights == replace(ObjectiveWeights(), mean=2)
    assert options.rotation_step == radians(4)
    assert (options.sample, options.clearance, options.seed) == (0.004, 0.005, 7)
    assert options.fixed == (FixedRotation(3, pi / 2),)
    assert options.method == "global"


BAD = [
    ("rotation_steps_deg=3", ["--set", "unknown key 'rotation_steps_deg'", "did you mean 'rotation_step_deg'?"]),
    ("rotation_step_deg=no", ["--set", "rotation_step_deg", "found the text 'no'", "expected a number"]),
    ("rotation_step_deg=0.1", ["found 0.1", "greater than or equal to 0.5", "0.5 to 90"]),
    ("rotation_step_deg", ["--set", "found 'rotation_step_deg'", "expected key=value"]),
    ("=3", ["--set", "expected key=value"]),
    ("force_N.x=3", ["force_N.x", "valid: travel, normal, axial"]),
    ("force_N=3", ["force_N", "found 3", "a mapping with travel, normal, axial"]),
    ("force_N.axial=.inf", ["force_N.axial", "finite"]),
    ("weights.mean=-1", ["weights.mean", "found -1", "greater than or equal to 0"]),
    ("method=globl", ["method", "found the text 'globl'", "did you mean 'global'?"]),
    ("index=3", ["index", "found 3", "'deflection'"]),
    ("rotation_range_deg=[90, -90]", ["rotation_range_deg", "found [90.0, -90.0]", "lowest < highest"]),
    ("rotation_range_deg=[-200, 0]", ["rotation_range_deg", "-180 ≤ lowest"]),
    ("rotation_range_deg=[0]", ["rotation_range_deg", "found a list of 1", "expected 2 values"]),
    ("rotation_range_deg=[0, 3]", ["rotation_step_deg", "a step of 5.0° does not fit", "0.0°…3.0°"]),
    ("fixed=[{point: 1, gamma_deg: 0}, {point: 1, gamma_deg: 9}]", ["fixed", "point 1 is given twice"]),
    (
        "steer=[{point: 1, operation: a, branch: 1}]",
        ["steer[0]", "point", "operation", "exactly one of them gives the position"],
    ),
    ("steer=[{point: 1}]", ["steer[0]", "is empty", "gamma_deg, forbid_deg, prefer_deg, branch"]),
    ("steer=[{points: [5, 2], branch: 1}]", ["points: found [5, 2]", "[first, last]"]),
    ("steer=[{forbid_deg: [20, 20]}]", ["forbid_deg: found [20", "two angles"]),
    ("steer=[{gamma_deg: 3, weight: 2}]", ["weight", "prefer_deg"]),
    ("fixed=[{point: -1, gamma_deg: 0}]", ["fixed[0].point", "found -1"]),
    ("fixed=[{point: 1.5, gamma_deg: 0}]", ["fixed[0].point", "found 1.5", "a whole number"]),
    ("collision=1", ["collision", "found 1", "true or false"]),
    ("seed=1.5", ["seed", "found 1.5", "a whole number"]),
    ("limit_scale=1.2", ["limit_scale", "found 1.2", "less than or equal to 1"]),
    ("weights={mean: 0, worst: 0}", ["weights", "mean and worst are both 0"]),
    ("seed=[1", ["--set seed", "is not YAML"]),
]


@pytest.mark.parametrize(("word", "parts"), BAD, ids=[b[0] for b in BAD])
def test_invalid_options_are_refused(word: str, parts: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        load_options({}, None, [word])
    for part in parts:
        assert part in str(caught.value)


def test_fixed_rotation_must_be_in_the_range() -> None:
    with pytest.raises(InputError, match=r"point 2 is fixed at 100.0°, outside the range -90.0°…90.0°"):
        load_options({"rotation_range_deg": [-90, 90]}, None, ["fixed=[{point: 2, gamma_deg: 100}]"])


def test_plan_file_is_named_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text("seed: 1\nsample: 12\n")
    with pytest.raises(InputError, match=r"plan.yaml: line 2: sample: unknown key 'sample'; did you mean 'sample_ms'"):
        load_options({}, file)
    with pytest.raises(InputError, match=r"nowhere.yaml: no such file"):
        load_options({}, tmp_path / "nowhere.yaml")


def test_cell_and_direct_options_are_validated() -> None:
    with pytest.raises(InputError, match=r"cell.yaml: plan.seed: found -1"):
        load_options({"seed": -1})
    with pytest.raises(InputError, match=r"options: sead: unknown key"):
        load_options(sead=1)


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["preferred_weight=3"], "preferred_weight has no effect: no preferred_rotation_deg is given"),
        (["preferred_rotation_deg=3", "preferred_weight=0"], "preferred_weight is 0"),
        (["collision=false", "clearance_mm=9"], "clearance_mm has no effect: collision is false"),
        (["method=jiao2022", "weights.mean=3"], "weights has no effect: method jiao2022"),
        (["method=default", "rotation_range_deg=[90, 120]"], "rotation_range_deg has no effect"),
        (["external.e1={mode: locked, range_mm: [0, 9]}"], "external.e1.range_mm has no effect: the joint is locked"),
        (["external.e1={mode: locked, preferred_deg: 3}"], "external.e1.preferred_deg has no effect"),
        (["external.e1={mode: moving, at_deg: 3}"], "external.e1.at_deg has no effect: the joint is locked nowhere"),
    ],
)
def test_options_disabled_by_others_are_named(words: list[str], part: str) -> None:
    (output,) = find_options_without_effect(load_options(overrides=words))
    assert part in output
    assert find_options_without_effect(load_options(overrides=words[:0])) == ()


def test_fixed_rotations_unsupported_by_the_method_are_refused(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text(
        "x_mm,y_mm,z_mm,i,j,k,feed_mm_min,kind\n0,0,0,0,0,1,100,path\n9,0,0,0,0,1,100,\n"
    )
    cell = Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling"
    words = ("method=jiao2022", "fixed=[{point: 0, gamma_deg: 10}]")
    with pytest.raises(InputError, match="method jiao2022 chooses every rotation by itself"):
        run_optimize(OptimizeRequest(cell=cell, toolpath=tmp_path / "path.csv", out=tmp_path / "out", overrides=words))
    assert not (tmp_path / "out").exists()


def test_clearance_weight_requires_collision_checks() -> None:
    options = load_options({"weights": {"clearance": 0.4}, "clearance_full_mm": 80})
    assert (options.weights.clearance, options.clearance_full) == (0.4, pytest.approx(0.08))
    assert load_options(format_user_options(options)) == options
    with pytest.raises(InputError, match="collision=true would work"):
        load_options({"weights": {"clearance": 0.4}, "collision": False})


def test_every_option_has_one_row_for_si_conversion() -> None:
    assert {o.key for o in OPTIONS} == set(OptionKeys.model_fields) - {"machopt_plan"}
    assert {o.name for o in OPTIONS} == {f.name for f in fields(PlanOptions)}
    assert load_options(format_user_options(PlanOptions())) == PlanOptions()
