"""Every elastic term compared with virtual joints in pinocchio and loaded springs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from test_beam_compliance import EA, EI, GJ, slices

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.data_types.effect_locations import is_on_arm
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.errors import InputError
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_robot
from machopt.planning.cost.stiffness_index import compute_load_directions, score_candidates
from machopt.planning.pipeline.planning_setup import prepare_planning
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.stations.planning_path import build_planning_path
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.terms import LinearTerm, build_fitted_term, compile_terms, list_effects_and_locations
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parent.parent
PSD = (
    np.array(
        [
            [2.0, 0.3, 0, 0, 0.1, 0],
            [0.3, 1.0, 0, 0, 0, 0.2],
            [0, 0, 3, 0.4, 0, 0],
            [0, 0, 0.4, 2, 0, 0],
            [0.1, 0, 0, 0, 1.5, 0],
            [0, 0.2, 0, 0, 0, 1.2],
        ]
    )
    * 1e-8
)
CYLINDERS = [
    {"diameter_mm": 60.0, "length_mm": 90.0, "youngs_GPa": 210.0, "bore_mm": 25.0},
    {"diameter_mm": 20.0, "length_mm": 50.0, "youngs_GPa": 600.0, "poisson": 0.22},
]
FORMS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "beam": ("link_compliance", "link:4", {"EI_Nm2": EI, "GJ_Nm2": GJ}),
    "beam, stretched too": ("link_compliance", "link:2", {"EI_Nm2": EI, "GJ_Nm2": GJ, "EA_N": EA}),
    "beam between points": (
        "link_compliance",
        "link:3",
        {"EI_Nm2": EI, "from_mm": [300.0, 0, 1900], "to_mm": [900.0, 50, 2000]},
    ),
    "diagonal": ("link_compliance", "link:5", {"compliance_diagonal": [1e-9, 2e-9, 0, 1e-8, 3e-8, 2e-8]}),
    "full": ("link_compliance", "link:3", {"compliance": PSD.tolist()}),
    "base": ("base_compliance", "base", {"compliance_diagonal": [0, 0, 0, 2e-8, 3e-8, 1e-8]}),
    "base, full, elsewhere": ("base_compliance", "base", {"compliance": PSD.tolist(), "at_mm": [100.0, -50, -300]}),
    "tool": ("tool_compliance", "tool", {"EI_Nm2": 2e4, "GJ_Nm2": 1e4}),
    "tool, own length": ("tool_compliance", "tool", {"EI_Nm2": 2e4, "GJ_Nm2": 1e4, "EA_N": 1e8, "length_mm": 180.0}),
    "tool, full": ("tool_compliance", "tool", {"compliance": PSD.tolist()}),
    "cylinders": ("tool_compliance", "tool", {"cylinders": CYLINDERS}),
    "cylinders and sensor": (
        "tool_compliance",
        "tool",
        {"cylinders": CYLINDERS, "sensor_N_per_mm": [7.4e4, 7.4e4, 9.8e4], "sensor_Nm_per_rad": [1.2e5, 1.2e5, 2.0e5]},
    ),
    "coupling": ("joint_coupling", "joint:4-5", {"compliance_rad_per_Nm": 3e-7}),
    "posture": ("joint_pose_dependent_stiffness", "joint:2", {"cos_rad_per_Nm": 2e-8, "sin_rad_per_Nm": -1e-8}),
}
BODIES = {name for name, (effect, _, _) in FORMS.items() if not effect.startswith("joint")}


@pytest.fixture(scope="module")
def arm() -> tuple[Robot, np.ndarray]:
    cell = load_cell(ROOT / "cells" / "irb6700_drilling")
    return load_robot(cell), cell.tool.T_flange_tcp


def postures(n: int, seed: int = 0) -> np.ndarray:
    q = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 6)) * 0.5
    return q + np.radians([10, -20, 30, 40, -60, 70.0])


def make(arm: tuple[Robot, np.ndarray], form: str) -> LinearTerm:
    effect, location, parameters = FORMS[form]
    return build_fitted_term(effect, location, *arm, **parameters)


def compliance(arm: tuple[Robot, np.ndarray], term: LinearTerm, q: np.ndarray) -> np.ndarray:
    """Return (M, 6, 6) at the TCP: the response to each unit wrench."""
    state = arm[0].compute_state(q, arm[1], bodies=True)
    units = [term.compute_response(state, np.broadcast_to(e, (len(q), 6))) @ term.values for e in np.eye(6)]
    return np.stack(units, axis=-1)


# --- springs in bodies: virtual joints ----------------------------------------------------------------------


def with_virtual_joint(robot: Robot, body: int, S: np.ndarray) -> Any:
    """Return the arm with three prismatic and three revolute joints along and about the axes
    of S, after joint ``body``."""
    model, parent, frame = pin.Model(), 0, np.eye(4)

    def add(joint: Any, place: np.ndarray, name: str) -> None:
        nonlocal parent, frame
        parent = model.addJoint(parent, joint, pin.SE3(np.linalg.inv(frame) @ place), name)
        frame = place

    for i in range(7):
        if i:
            place = np.eye(4)
            place[:3, 3] = robot.point[i - 1]
            add(pin.JointModelRevoluteUnaligned(robot.axis[i - 1]), place, f"q{i}")
        if i == body:
            for kind in ("PX", "PY", "PZ", "RX", "RY", "RZ"):
                add(getattr(pin, f"JointModel{kind}")(), S, kind)
    return model, frame


def tip(model: Any, frame: np.ndarray, T_base_tcp: np.ndarray, q: np.ndarray, body: int, give: np.ndarray) -> pin.SE3:
    data = model.createData()
    pin.forwardKinematics(model, data, np.concatenate([q[:body], give, q[body:]]))
    return data.oMi[model.njoints - 1] * pin.SE3(np.linalg.inv(frame) @ T_base_tcp)


def spring_of(arm: tuple[Robot, np.ndarray], form: str) -> tuple[int, np.ndarray, np.ndarray]:
    """Return body, frame S at q = 0 and C_S of a form, from the parameters alone."""
    robot, tool = arm
    effect, location, p = FORMS[form]
    T_tcp = robot.T_base_flange_zero @ tool
    points = [*robot.point, robot.T_base_flange_zero[:3, 3]]
    body = {"base": 0, "tool": 6}.get(location) if ":" not in location else int(location.split(":")[1])
    assert body is not None
    start, end = points[max(body, 1) - 1], points[body] if body else np.zeros(3)
    start, end = np.array(p.get("from_mm", start * 1e3)) / 1e3, np.array(p.get("to_mm", end * 1e3)) / 1e3
    along, S = end - start, np.eye(4)
    S[:3, 3] = end
    if effect == "tool_compliance":
        along, S[:3, 3] = T_tcp[:3, 2] * (T_tcp[:3, 2] @ (T_tcp[:3, 3] - points[6])), T_tcp[:3, 3]
    if effect == "base_compliance":
        S[:3, 3] = np.array(p.get("at_mm", [0, 0, 0])) / 1e3
    if "compliance" in p or "compliance_diagonal" in p:
        C = np.array(p["compliance"]) if "compliance" in p else np.diag(p["compliance_diagonal"])
        if effect == "tool_compliance":
            S[:3, :3] = make(arm, form).T_base_spring[:3, :3]  # type: ignore[attr-defined]
            # x out of the tool, y and z perpendicular to it
            np.testing.assert_allclose(S[:3, 0], T_tcp[:3, 2], atol=1e-12)
        return body, S, C
    length = p.get("length_mm", np.linalg.norm(along) * 1e3) / 1e3
    x = along / np.linalg.norm(along)
    y = np.cross(x, [0.3, 0.5, -0.8])  # the directions have no effect for a round bar
    S[:3, :3] = np.column_stack([x, y / np.linalg.norm(y), np.cross(x, y / np.linalg.norm(y))])
    parts = [(1.0, p["EI_Nm2"], p.get("GJ_Nm2", np.inf), p.get("EA_N", np.inf))]
    return body, S, np.column_stack([slices(e, length, parts, 2000) for e in np.eye(6)])


@pytest.mark.parametrize("form", sorted(BODIES - {"cylinders", "cylinders and sensor"}))
def test_body_springs_equal_virtual_joints_in_pinocchio(arm: tuple[Robot, np.ndarray], form: str) -> None:
    """The displacement of the spring, C_S times the wrench at its frame, as a finite motion of six virtual joints."""
    robot, tool = arm
    body, S, C_S = spring_of(arm, form)
    model, frame = with_virtual_joint(robot, body, S)
    T_tcp = robot.T_base_flange_zero @ tool
    term, q = make(arm, form), postures(6)
    mine = compliance(arm, term, q)
    for i in range(len(q)):
        rest = tip(model, frame, T_tcp, q[i], body, np.zeros(6))
        np.testing.assert_allclose(rest.homogeneous, robot.compute_fk(q[i], tool), atol=1e-12)
        data = model.createData()
        pin.forwardKinematics(model, data, np.concatenate([q[i, :body], np.zeros(6), q[i, body:]]))
        place = data.oMi[body + 6]
        for column, w in enumerate(np.eye(6)):
            lever = rest.translation - place.translation
            local = np.r_[place.rotation.T @ w[:3], place.rotation.T @ (w[3:] + np.cross(lever, w[:3]))]
            give = C_S @ local
            scale = 1e-5 / max(np.abs(give).max(), 1e-300)  # 1e-5 m or rad; odd part: cubic terms are 1e-10 of it
            there, back = (tip(model, frame, T_tcp, q[i], body, s * scale * give) for s in (1.0, -1.0))
            shift = 0.5 * (there.translation - back.translation) / scale
            turn = 0.5 * pin.log3(there.rotation @ back.rotation.T) / scale
            found = mine[i, :, column]
            # 2,000 slices have a relative error of 6e-8 for a cubic; FK rounds to 3e-16 m over motions of 1e-5 m
            np.testing.assert_allclose(found[:3], shift, atol=2e-7 * np.abs(shift).max() + 1e-30)
            np.testing.assert_allclose(found[3:], turn, atol=2e-7 * np.abs(turn).max() + 1e-30)


def test_flange_sensor_is_a_virtual_joint_before_the_tool(arm: tuple[Robot, np.ndarray]) -> None:
    robot, tool = arm
    _, _, p = FORMS["cylinders and sensor"]
    C = np.diag(np.r_[1e-3 / np.array(p["sensor_N_per_mm"]), 1.0 / np.array(p["sensor_Nm_per_rad"])])
    q = postures(4)
    both, bare = (compliance(arm, make(arm, form), q) for form in ("cylinders and sensor", "cylinders"))
    model, frame = with_virtual_joint(robot, 6, robot.T_base_flange_zero)
    T_tcp = robot.T_base_flange_zero @ tool
    for i in range(len(q)):
        data = model.createData()
        full = np.concatenate([q[i], np.zeros(6)])
        pin.computeJointJacobians(model, data, full)
        T = tip(model, frame, T_tcp, q[i], 6, np.zeros(6))
        J = pin.getJointJacobian(model, data, model.njoints - 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:, 6:]
        lever = T.translation - data.oMi[model.njoints - 1].translation
        J = np.vstack([J[:3] - np.array([np.cross(lever, J[3:, c]) for c in range(6)]).T, J[3:]])
        np.testing.assert_allclose(both[i] - bare[i], J @ C @ J.T, rtol=1e-9, atol=1e-20)


# --- all terms ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_terms_are_symmetric_and_body_springs_never_stiffen(arm: tuple[Robot, np.ndarray], form: str) -> None:
    C = compliance(arm, make(arm, form), postures(12, 1))
    size = np.sqrt(np.abs(np.einsum("mii->mi", C)).max(axis=0)) + 1e-12
    scaled = C / size[:, None] / size
    np.testing.assert_allclose(scaled, np.swapaxes(scaled, 1, 2), atol=1e-12)
    if form in BODIES:
        assert np.linalg.eigvalsh(scaled).min() > -1e-12


def test_compliances_add_and_scale_with_their_coefficients(arm: tuple[Robot, np.ndarray]) -> None:
    robot, tool = arm
    q, k = postures(5, 2), np.array([2.6e6, 9.4e5, 6.6e5, 9.2e5, 4.4e4, 2.7e4])
    chosen = ["beam", "base", "cylinders and sensor", "coupling", "posture"]
    file = tuple(StiffnessTerm(*FORMS[f]) for f in chosen)
    together = ArmElasticity(robot, tool, ArmStiffness(joints=k, terms=file)).evaluate(q).compute_compliance()
    joints = ArmElasticity(robot, tool, ArmStiffness(joints=k)).evaluate(q).compute_compliance()
    parts = [compliance(arm, make(arm, f), q) for f in chosen]
    np.testing.assert_allclose(together, joints + sum(parts), rtol=1e-10, atol=1e-20)
    beam = make(arm, "beam, stretched too")
    np.testing.assert_allclose(
        compliance(arm, beam.with_values(3 * beam.values), q), 3 * compliance(arm, beam, q), rtol=1e-12
    )
    # one response row per coefficient, as a fit needs it
    state, w = robot.compute_state(q, tool, bodies=True), np.broadcast_to([10.0, -20, 30, 1, 2, -3], (5, 6))
    for p in range(3):
        alone = np.zeros(3)
        alone[p] = beam.values[p]
        np.testing.assert_allclose(
            beam.compute_response(state, w)[..., p] * beam.values[p],
            np.einsum("mij,mj->mi", compliance(arm, beam.with_values(alone), q), w),
            rtol=1e-9,
            atol=1e-18,
        )


@pytest.mark.parametrize("form", FORMS)
def test_rotating_the_tcp_frame_about_its_axis_changes_no_number(arm: tuple[Robot, np.ndarray], form: str) -> None:
    """Wrench and twist are in base axes, so a TCP frame rotated
    in itself is the same point; includes stated matrices."""
    robot, tool = arm
    turned = tool @ pin.SE3(pin.utils.rotate("z", 0.7), np.zeros(3)).homogeneous
    effect, location, p = FORMS[form]
    q = postures(4, 3)
    a, b = (compliance((robot, t), build_fitted_term(effect, location, robot, t, **p), q) for t in (tool, turned))
    np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-20)


def test_base_rotating_about_axis_1_only_equals_joint_1(arm: tuple[Robot, np.ndarray]) -> None:
    """The two are indistinguishable: no reading separates a soft joint 1 from a base
    that rotates about the same line."""
    robot, tool = arm
    np.testing.assert_allclose(np.abs(robot.axis[0]), [0, 0, 1], atol=1e-12)
    c = 4e-7
    at = (robot.point[0] * 1e3).tolist()
    base = build_fitted_term("base_compliance", "base", robot, tool, compliance_diagonal=[0, 0, 0, 0, 0, c], at_mm=at)
    q = postures(8, 4)
    _, J = robot.compute_fk_jacobian(q, tool)
    np.testing.assert_allclose(
        compliance(arm, base, q), c * J[:, :, :1] @ np.swapaxes(J[:, :, :1], 1, 2), rtol=1e-9, atol=1e-20
    )


def test_joint_terms_equal_loaded_springs(arm: tuple[Robot, np.ndarray]) -> None:
    """Full nonlinear kinematics at Δq = C_θ Jᵀw for small loads."""
    robot, tool = arm
    q = postures(5, 5)
    spring = {"coupling": np.zeros((6, 6)), "posture": np.zeros((6, 6))}
    spring["coupling"][3, 4] = spring["coupling"][4, 3] = 3e-7
    for form, C in spring.items():
        mine = compliance(arm, make(arm, form), q)
        for i in range(len(q)):
            if form == "posture":
                C[1, 1] = 2e-8 * np.cos(q[i, 1]) - 1e-8 * np.sin(q[i, 1])
            J = pin_jacobian(robot, tool, q[i])
            for column, w in enumerate(np.eye(6)):
                turn = C @ J.T @ w
                if not turn.any():  # a force through the axes of the joints
                    assert not mine[i, :, column].any()
                    continue
                scale = 1e-6 / np.abs(turn).max()
                moved = (
                    robot.compute_fk(q[i] + scale * turn, tool)[:3, 3]
                    - robot.compute_fk(q[i] - scale * turn, tool)[:3, 3]
                )
                np.testing.assert_allclose(mine[i, :3, column], 0.5 * moved / scale, rtol=1e-5, atol=1e-14)


def pin_jacobian(robot: Robot, tool: np.ndarray, q: np.ndarray) -> np.ndarray:
    model, frame = with_virtual_joint(robot, 9, np.eye(4))
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    J = pin.getJointJacobian(model, data, 6, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    T = data.oMi[6] * pin.SE3(np.linalg.inv(frame) @ robot.T_base_flange_zero @ tool)
    lever = T.translation - data.oMi[6].translation
    return np.vstack([J[:3] - np.array([np.cross(lever, J[3:, c]) for c in range(6)]).T, J[3:]])


# --- files ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_every_form_survives_its_file(arm: tuple[Robot, np.ndarray], form: str, tmp_path: Path) -> None:
    robot, tool = arm
    term, q = make(arm, form), postures(3, 6)
    file = tmp_path / "stiffness.yaml"
    write_stiffness(file, ArmStiffness(joints=np.full(6, 1e6), terms=(term.to_file(),)))
    again, geometric = compile_terms(load_stiffness(file).terms, robot, tool, file)
    assert not geometric
    assert len(again) == 1
    np.testing.assert_allclose(compliance(arm, again[0], q), compliance(arm, term, q), rtol=1e-12, atol=1e-24)
    assert [c.name for c in again[0].coefficients] == [c.name for c in term.coefficients]
    twice = again[0].with_values(2 * again[0].values).to_file()
    double = compile_terms((twice,), robot, tool)[0][0]
    np.testing.assert_allclose(compliance(arm, double, q), 2 * compliance(arm, term, q), rtol=1e-12, atol=1e-24)


def test_terms_to_be_fitted_have_coefficients_without_values(arm: tuple[Robot, np.ndarray]) -> None:
    counts = {
        ("link_compliance", "link:4", "beam"): 2,
        ("link_compliance", "link:4", "full"): 21,
        ("base_compliance", "base", "diagonal"): 6,
        ("base_compliance", "base", "full"): 21,
        ("tool_compliance", "tool", "beam"): 2,
    }
    for (effect, location, form), n in counts.items():
        term = build_fitted_term(effect, location, *arm, form=form)
        assert len(term.coefficients) == n == len(term.values)
        assert np.isnan(term.values).all()
    for effect, locations in list_effects_and_locations().items():
        for location in (place for place in locations if is_on_arm(place, 6)):
            if effect != "geometric_stiffness":
                assert build_fitted_term(effect, location, *arm).location == location
    nowhere = {"from_mm": [1.0, 2, 3], "to_mm": [1.0, 2, 3]}  # a matrix needs no length
    assert len(build_fitted_term("link_compliance", "link:5", *arm, form="diagonal", **nowhere).values) == 6


@pytest.mark.parametrize(
    ("effect", "location", "parameters", "message", "where"),
    [
        ("link_complianse", "link:4", {}, "did you mean 'link_compliance'", "terms[0].effect"),
        ("joint_zero_offset", "joint:2", {}, "is not known", "terms[0].effect"),
        ("link_compliance", "link:7", {}, "cannot be at 'link:7'; valid: link:1", "terms[0].location"),
        ("joint_coupling", "joint:5-4", {}, "valid: joint:1-2, joint:1-3", "terms[0].location"),
        ("link_compliance", "link:2", {"EI_across_Nm2": 1e6}, "normal", "terms[0].parameters.normal"),
        ("link_compliance", "link:2", {"EI_Nm2": 1e6, "taper": 0.0}, "more than zero", "terms[0].parameters.taper"),
        ("link_compliance", "link:2", {"EI_Nm2": 1e6, "shear": -1.0}, "at least zero", "terms[0].parameters.shear"),
        ("link_compliance", "link:2", {"compliance_diagonal": [0] * 6, "taper": 0.5}, "unknown key", "taper"),
        ("tool_compliance", "tool", {"EI_Nm2": 1e6, "taper": 0.5}, "unknown key", "terms[0].parameters.taper"),
        ("link_compliance", "link:2", {"EI_across_Nm2": 1e6, "normal": [0, 0, 0]}, "an axis across it", "normal"),
        ("link_compliance", "link:4", {"EI_Nm": 1.0}, "EI_Nm2", "terms[0].parameters.EI_Nm"),
        ("link_compliance", "link:4", {"EI_Nm2": -1.0}, "found -1; expected more than zero", "parameters.EI_Nm2"),
        ("link_compliance", "link:4", {"EI_Nm2": "soft"}, "'soft'; expected a number", "parameters.EI_Nm2"),
        ("link_compliance", "link:5", {"from_mm": [1, 2, 3], "to_mm": [1, 2, 3]}, "makes no beam", "[0].parameters"),
        ("link_compliance", "link:4", {"from_mm": [0, 0]}, "expected 3 finite numbers", "parameters.from_mm"),
        ("base_compliance", "base", {"form": "beam"}, "valid: diagonal, full", "parameters.form"),
        (
            "base_compliance",
            "base",
            {"compliance_diagonal": [1, 1, 1, 1, 1, -1]},
            "at least zero",
            "compliance_diagonal",
        ),
        ("base_compliance", "base", {"compliance": np.triu(np.ones((6, 6))).tolist()}, "not symmetric", "compliance"),
        ("base_compliance", "base", {"compliance": (np.eye(6) - 0.5).tolist()}, "negative eigenvalue", "compliance"),
        ("tool_compliance", "tool", {"cylinders": []}, "expected a list of mappings", "cylinders"),
        (
            "tool_compliance",
            "tool",
            {"cylinders": [{"diameter_mm": 20}]},
            "length_mm is needed",
            "cylinders[0].length_mm",
        ),
        (
            "tool_compliance",
            "tool",
            {"cylinders": [{**CYLINDERS[0], "bore_mm": 60}]},
            "less than the diameter",
            "bore_mm",
        ),
        ("tool_compliance", "tool", {"cylinders": CYLINDERS, "sensor_N_per_mm": [1, 1, 0]}, "above zero", "sensor_N"),
    ],
)
def test_invalid_terms_are_reported_with_their_place(
    arm: tuple[Robot, np.ndarray], effect: str, location: str, parameters: Mapping[str, Any], message: str, where: str
) -> None:
    with pytest.raises(InputError) as caught:
        compile_terms((StiffnessTerm(effect, location, parameters),), *arm, Path("stiffness.yaml"))
    assert message in str(caught.value)
    assert where in str(caught.value)
    assert "stiffness.yaml" in str(caught.value)


def test_duplicate_term_is_refused(arm: tuple[Robot, np.ndarray]) -> None:
    term = StiffnessTerm(*FORMS["beam"])
    with pytest.raises(InputError, match="is given twice"):
        compile_terms((term, term), *arm)
    _, geometric = compile_terms((StiffnessTerm("geometric_stiffness", "arm"),), *arm)
    assert geometric


# --- in the planner ------------------------------------------------------------------------------------------


def test_planner_scores_candidates_with_the_terms() -> None:
    """Recompute the cost of every candidate from the summed compliance matrices,
    for both indices; terms only soften."""
    cell = load_cell(ROOT / "cells" / "irb6700_drilling")
    assert cell.stiffness is not None
    soft = replace(cell.stiffness, terms=(StiffnessTerm(*FORMS["beam"]), StiffnessTerm(*FORMS["tool"])))
    toolpath = read_toolpath(ROOT / "toolpaths" / "plate_holes.csv")
    from machopt.options.plan_option_reader import load_options

    for index in ("deflection", "stiffness"):
        options = load_options(cell.plan, None, ["rotation_step_deg=45", "collision=false"], index=index)
        costs = []
        for stiffness in (cell.stiffness, soft):
            setup = prepare_planning(replace(cell, stiffness=stiffness), options)
            path = build_planning_path(toolpath)
            d = compute_load_directions(path, setup.arm, setup.elasticity, options.force)
            candidates = enumerate_candidates(path, setup.arm, options)
            costs.append(score_candidates(path, candidates, setup.elasticity, d, options).cost)
        known = np.argwhere(np.isfinite(costs[1]))
        assert len(known) > 500
        assert (costs[1][np.isfinite(costs[1])] > costs[0][np.isfinite(costs[0])]).all()
        for s, r, b in known[:: len(known) // 40]:
            q, p = candidates.q[s, r, b], path.stations[s]
            C = setup.elasticity.evaluate(q[None]).compute_compliance()[0, :3, :3]
            if index == "deflection":
                expected = np.linalg.norm(C @ d.force[p])
            elif d.drilling[p]:
                expected = d.axial[p] @ C @ d.axial[p]
            else:
                expected = 0.5 * (d.axial[p] @ C @ d.axial[p] + d.normal[p] @ C @ d.normal[p])
            assert costs[1][s, r, b] == pytest.approx(expected, rel=1e-9)


def test_tool_beside_its_flange_has_a_compliance_without_a_length(arm: tuple[Robot, np.ndarray]) -> None:
    """An angle head has its TCP next to the flange: a beam has no length there, a matrix needs none."""
    robot, T = arm[0], arm[1].copy()
    T[:3, 3] = T[:3, :3] @ np.array([0.15, 0.0, 0.0])
    for form in ("diagonal", "full"):
        term = build_fitted_term("tool_compliance", "tool", robot, T, form=form)
        assert len(term.coefficients) == (6 if form == "diagonal" else 21)
        assert "length_mm" not in term.with_values(np.ones(len(term.coefficients))).to_file().parameters
    with pytest.raises(InputError, match="across the tool axis"):
        build_fitted_term("tool_compliance", "tool", robot, T)
    assert len(build_fitted_term("tool_compliance", "tool", robot, T, length_mm=150.0).coefficients) == 2
