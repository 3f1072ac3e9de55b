"""Bushing simulator, compared with independent results."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks" / "diagnosis_bushing_benchmark"))

from bushing_simulator import gear_laws as gears
from bushing_simulator.bushing_bodies import PointLoad, move_posture
from bushing_simulator.case_files import write_case
from bushing_simulator.case_list import list_cases
from bushing_simulator.gear_laws import Drive
from bushing_simulator.reference_kinematics import compute_frames, compute_gravity_torque, compute_jacobian
from bushing_simulator.robot_assembly import HiddenPhysics, assemble_arm
from bushing_simulator.robot_descriptions import ROBOTS

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks" / "diagnosis_bushing_benchmark"
COUNT = 5


def _build(name, **hidden):
    robot = ROBOTS[name]
    return robot, assemble_arm(
        robot, HiddenPhysics(robot.springs, robot.masses, robot.tool_mass, robot.tool_center, **hidden)
    )


def _draw_postures(robot, seed=1):
    share = np.random.default_rng(seed).uniform(0.3, 0.7, (COUNT, 6))
    return np.deg2rad(robot.limits_deg[:, 0] + share * np.diff(robot.limits_deg)[:, 0])


def _solve(arm, q, loads, start=None, torque=None):
    drive = Drive(np.zeros((len(q), 6)) if torque is None else torque, q, np.full(len(q), 20.0), np.ones((len(q), 6)))
    return arm.solve_step(drive, loads, start)


def _move(arm, q, point, force):
    """Return the displacement (N, 3) of a point of the tool from the difference of two opposite loads."""
    start = _solve(arm, q, [])
    both = [_solve(arm, q, [PointLoad(arm.tool_body, point, s * force)], start.posture, start.torque) for s in (1, -1)]
    return 0.5 * (arm.find_tcp(both[0].posture)[0] - arm.find_tcp(both[1].posture)[0])


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_small_loads_move_the_tcp_by_J_C_Jt(name):
    robot, arm = _build(name)
    # without weight the tangent at rest is J C Jᵀ, without geometric stiffness
    arm = assemble_arm(robot, HiddenPhysics(robot.springs, 0 * robot.masses, 0.0, robot.tool_center))
    arm.chain.bodies[0] = arm.chain.bodies[0].__class__(**{**vars(arm.chain.bodies[0]), "mass": 0.0})
    q = _draw_postures(robot)
    force = np.tile([40.0, -30.0, 20.0], (COUNT, 1))
    J = compute_jacobian(robot, q)[:, :3]
    expected = np.einsum("nij,j,nkj,nk->ni", J, 1 / robot.springs, J, force)
    np.testing.assert_allclose(_move(arm, q, robot.tcp, force), expected, atol=2e-4 * np.abs(expected).max())


def test_joint_torques_equal_those_of_the_weights():
    robot, arm = _build("irb6640")
    q = _draw_postures(robot)
    torque = _solve(arm, q, []).torque
    expected = compute_gravity_torque(robot, q, robot.masses, robot.tool_mass)
    # the levers of the deflected posture differ by the deflection, about 2 mm of 2 m
    np.testing.assert_allclose(torque, expected, atol=4e-3 * np.abs(expected).max())


def test_forces_are_the_gradient_of_the_energy_and_balance():
    robot, arm = _build("kr120", link_softness={2: 3.0}, base_softness=2.0, tool_softness=5.0, compensator=1.0)
    q = _draw_postures(robot)
    loads = [PointLoad(arm.tool_body, robot.tcp, np.tile([300.0, -200.0, 500.0], (COUNT, 1)))]
    state = _solve(arm, q, loads)
    assert state.residual < 1e-3  # N, N·m, for loads of some kN
    rng = np.random.default_rng(0)
    # away from equilibrium: residual · step = change of energy (central difference)
    moved = move_posture(state.posture, rng.normal(0, 1e-6, (COUNT, len(arm.chain.bodies), 6)))
    step = rng.normal(0, 1e-7, (COUNT, len(arm.chain.bodies), 6))
    residual = arm.chain.compute_balance(moved, q, loads)[0]
    rise = 0.5 * sum(s * arm.chain.compute_energy(move_posture(moved, s * step), q, loads) for s in (1, -1))
    np.testing.assert_allclose(rise, np.sum(residual * step, axis=(1, 2)), rtol=1e-4)
    # the equilibrium is an energy minimum
    lowest = arm.chain.compute_energy(state.posture, q, loads)
    assert np.all(arm.chain.compute_energy(moved, q, loads) > lowest)


def test_reciprocity_between_two_points_and_directions():
    robot, arm = _build("m710", link_softness={2: 5.0, 4: 5.0}, base_softness=3.0, tool_softness=5.0)
    q = _draw_postures(robot)
    other = robot.tcp + np.array([-0.1, 0.2, -0.15])
    f, g = np.tile([50.0, 20.0, -10.0], (COUNT, 1)), np.tile([-20.0, 40.0, 30.0], (COUNT, 1))
    start = _solve(arm, q, [])

    def measure(point, load, force):
        both = [
            _solve(arm, q, [PointLoad(arm.tool_body, load, s * force)], start.posture, start.torque) for s in (1, -1)
        ]
        return 0.5 * (arm.find_tcp(both[0].posture, point)[0] - arm.find_tcp(both[1].posture, point)[0])

    first = np.sum(g * measure(other, robot.tcp, f), axis=1)
    second = np.sum(f * measure(robot.tcp, other, g), axis=1)
    np.testing.assert_allclose(first, second, rtol=1e-5)


def test_work_of_a_slow_load_is_the_stored_energy():
    robot, arm = _build("kr120", link_softness={3: 4.0}, compensator=1.0)
    q = _draw_postures(robot)
    force = np.tile([200.0, 500.0, -300.0], (COUNT, 1))
    state = _solve(arm, q, [])
    place, work = arm.find_tcp(state.posture)[0], np.zeros(COUNT)
    unloaded = arm.chain.compute_energy(state.posture, q, [])
    for level in np.linspace(0, 1, 9)[1:]:
        state = _solve(arm, q, [PointLoad(arm.tool_body, robot.tcp, level * force)], state.posture, state.torque)
        new = arm.find_tcp(state.posture)[0]
        work += np.sum((level - 1 / 16) * force * (new - place), axis=1)  # trapezoidal rule
        place = new
    stored = arm.chain.compute_energy(state.posture, q, []) - unloaded
    np.testing.assert_allclose(work, stored, rtol=3e-4)


def _follow(law, torques, duration):
    law.reset(1)
    path = []
    for t in torques:
        drive = Drive(np.full((1, 6), t), np.zeros((1, 6)), np.full(1, duration), np.ones((1, 6)))
        path.append(float(law.compute_extra(drive)[0]))
        law.advance(drive)
    return np.array(path)


def test_slip_hysteresis_is_closed_and_rate_independent():
    up_down = np.concatenate([np.linspace(0, 900, 10), np.linspace(900, -900, 19), np.linspace(-900, 900, 19)])
    slow, fast = (_follow(gears.SlipStack(1, 0.5, 1e6, 1000.0, 0.0), up_down, d) for d in (100.0, 0.1))
    np.testing.assert_array_equal(slow, fast)
    assert slow[9] == pytest.approx(slow[-1], abs=1e-9)  # closed (return-point memory)
    assert slow[19] - slow[37] > 0.1 * slow[9]  # near zero torque the branches differ


def test_creep_is_rate_dependent_and_converges():
    law = gears.CreepPair(1, 0.05, 1e6)
    slow = _follow(law, [0.0, 500.0], 5000.0)[-1]
    fast = _follow(law, [0.0, 500.0], 5.0)[-1]
    assert slow == pytest.approx(0.05 * 500 / 1e6, rel=1e-6)
    assert 0 < fast < 0.5 * slow


def test_backlash_opens_by_its_width_between_opposite_torques():
    law = gears.RoundedPlay(1, 3e-4, 1e6)
    path = _follow(law, [-600.0, 600.0], 1.0)
    assert path[1] - path[0] == pytest.approx(3e-4, rel=0.1)  # minus 2 % for the seal


def test_soft_pedestal_moves_a_pose_like_its_springs():
    robot, arm = _build("m710", base_softness=4.0)
    q = _draw_postures(robot)
    force = np.tile([0.0, 300.0, 0.0], (COUNT, 1))
    hard = _move(_build("m710")[1], q, robot.tcp, force)
    tcp = compute_frames(robot, q)[2]
    # bolts of 4e8/4 N/m at ±0.2 m in y: tilt compliance about x from M/(4 k b²); shear 4·3e8/4; torsion 3e8 (0.36² +
    # 0.2²)
    tilt = -300.0 * tcp[:, 2] / (4e8 * 0.2**2)
    twist = 300.0 * tcp[:, 0] / (3e8 * (0.36**2 + 0.2**2))
    turn = np.stack([tilt, 0 * tilt, twist], axis=1)
    expected = np.cross(turn, tcp) + np.array([0, 300.0 / 3e8, 0])
    np.testing.assert_allclose(_move(arm, q, robot.tcp, force) - hard, expected, atol=0.02 * np.abs(expected).max())


def test_same_seed_same_bytes_and_another_draw_differs(tmp_path):
    case = next(c for c in list_cases() if c.key.startswith("single/absolute/joint_zero_offset"))
    other = next(c for c in list_cases(draw=1) if c.key == case.key)
    texts = []
    for name, plan in (("a", case), ("b", case), ("c", other)):
        write_case(plan, tmp_path / name)
        texts.append((tmp_path / name / "recording" / "data.csv").read_bytes())
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


def test_simulator_does_not_import_machopt():
    for path in FOLDER.joinpath("bushing_simulator").glob("*.py"):
        lines = path.read_text().splitlines()
        assert not [line for line in lines if line.lstrip().startswith(("import machopt", "from machopt"))]
