"""Load tests on a simulated arm with known true values, for tests and benchmarks of identify and diagnose.

The simulation is not linear in the compliances and shares no code with the fit. The arm is a chain of rigid bodies
whose joints rotate by c_i τ_i. Bodies may contain springs that deflect by finite rigid motions. Torques are those of
the deflected chain under load and weight, found by iteration to equilibrium. A displacement is the difference of two
such poses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import (
    compute_axis_rotation,
    convert_to_rotation_vector,
    convert_vector_to_rotation,
)

Compliance = Callable[[Array, Array], Array]  # q (M, 6) rad, TCP (M, 3) m in base_link → (M, 6) rad/(N·m)

AT_REST = 1e-13  # rad and m; far below the smallest displacement of interest, above rounding
MOST_STEPS = 400


@dataclass(frozen=True)
class SpringInBody:
    """A body divided at a frame S into two parts that are connected by a spring."""

    body: int  # 0 base_link, i link i (6: the tool side)
    T_base_spring: Array  # (4, 4) S in base_link at q = 0
    compliance: Array  # (6, 6) m, rad per N, N·m in axes of S


@dataclass(frozen=True)
class SmoothField:
    """Joint compliances that vary smoothly over the workspace: c_i = c0_i / (1 + a tanh φ_i).

    φ is a sum of random waves of unit variance, so the stiffness stays within ± a of its constant value.
    """

    constant: Array  # (6,) rad/(N·m)
    waves: Array  # (6, F, 3) or (6, F, 6) rad per m or per rad
    phases: Array  # (6, F) rad
    amplitude: Array  # (6,) share, below 1
    over: str = "position"  # "position": of the TCP in base_link; "joints": of q

    @classmethod
    def draw(
        cls,
        constant: Array,
        rng: np.random.Generator,
        *,
        amplitude: Array | float = 0.3,
        scale: float = 0.6,
        over: str = "position",
        waves: int = 32,
    ) -> SmoothField:
        """Draw a random field; ``scale`` is the length scale, in m over positions and in rad over joints."""
        size = 3 if over == "position" else 6
        return cls(
            np.asarray(constant, float),
            rng.standard_normal((6, waves, size)) / scale,
            rng.uniform(0, 2 * np.pi, (6, waves)),
            np.broadcast_to(np.asarray(amplitude, float), (6,)),
            over,
        )

    def __call__(self, q: Array, position: Array) -> Array:
        x = position if self.over == "position" else q
        phi = np.sqrt(2.0 / self.waves.shape[1]) * np.sum(
            np.cos(np.einsum("jfd,md->mjf", self.waves, x) + self.phases), axis=-1
        )
        return np.asarray(self.constant / (1.0 + self.amplitude * np.tanh(phi)))


@dataclass(frozen=True)
class TrueArm:
    """The true properties of the simulated arm."""

    robot: Robot
    T_flange_tcp: Array  # (4, 4)
    compliance: Array | Compliance  # (6,) rad/(N·m), or a law
    springs: tuple[SpringInBody, ...] = ()
    masses: RobotMasses | None = None  # None: no weight

    def compliance_at(self, q: Array) -> Array:
        """Return the compliances (M, 6) in rad/(N·m) at commanded joint positions q (M, 6)."""
        if callable(self.compliance):
            return self.compliance(q, self.robot.compute_fk(q, self.T_flange_tcp)[:, :3, 3])
        return np.broadcast_to(np.asarray(self.compliance, float), q.shape)

    def rest(self, q: Array, wrench: Array) -> tuple[Array, Array]:
        """Return the equilibrium pose of the TCP (M, 3, 3) and (M, 3), for encoder angles q (M, 6) and a wrench (M, 6)
        in base axes.

        Raises:
            ValueError: the springs cannot support the load (the iteration does not converge).
        """
        c = self.compliance_at(q)
        theta, twists = q.copy(), [np.zeros((len(q), 6)) for _ in self.springs]
        for _ in range(MOST_STEPS):
            hung = _compute_hanging_state(self, theta, twists)
            turned = q + c * hung.torque(wrench, self.masses)
            bent = [hung.twist(n, wrench, self.masses) for n in range(len(self.springs))]
            step = np.abs(np.concatenate([turned - theta, *(a - b for a, b in zip(bent, twists, strict=True))])).max()
            theta, twists = turned, bent
            if step < AT_REST:
                end = _compute_hanging_state(self, theta, twists)
                return end.R_tcp, end.p_tcp
        raise ValueError("the arm's springs do not hold this load: it comes to no rest")

    def displacement(self, q: Array, wrench: Array) -> Array:
        """Return the displacement (M, 6) in m and rad of the TCP by the load; the rotation is a rotation vector in
        base axes."""
        R0, p0 = self.rest(q, np.zeros_like(wrench))
        R1, p1 = self.rest(q, wrench)
        return np.concatenate([p1 - p0, convert_to_rotation_vector(R1 @ np.swapaxes(R0, -1, -2))], axis=-1)


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Errors of one recording, 1 sigma; typical of laser tracker, force sensor and robot."""

    white: float = 12e-6  # m, every reading
    cycle: float = 15e-6  # m, shared by the readings of a load cycle
    pose: float = 30e-6  # m, shared by the readings of a pose
    rotation: float = 0.03e-3  # rad, every reading
    force: float = 0.0075  # share of each component
    joint: float = np.deg2rad(0.0075)  # rad, encoder and transmission, constant at a pose
    outliers: float = 0.01  # share of readings
    outlier_size: float = 0.5e-3  # m
    outlier_turn: float = 0.5e-3  # rad

    @classmethod
    def none(cls) -> Noise:
        return cls(white=0.0, cycle=0.0, pose=0.0, rotation=0.0, force=0.0, joint=0.0, outliers=0.0)


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """A simulated recording with its true values."""

    recording: Recording
    q: Array  # (N, 6) rad, true commanded position
    wrench: Array  # (N, 6) N, N·m, true
    displacement: Array  # (N, 6) m, rad, without noise
    compliance: Array  # (N, 6) rad/(N·m), true
    outlier: NDArray[np.bool_] = field(repr=False)  # (N,)


def record(
    arm: TrueArm,
    poses: Array,
    loads: Array,
    rng: np.random.Generator,
    *,
    noise: Noise | None = None,
    repeats: int = 1,
    loads_per_cycle: int | None = None,
    rotations: bool = False,
    name: str = "simulated",
) -> Simulated:
    """Simulate measurements of an arm.

    Args:
        arm: the true arm.
        poses: (P, 6) rad.
        loads: (L, 6) N, N·m at the TCP in base axes, the same at every pose, or (P, L, 6).
        rng: for the errors.
        noise: None: the defaults of :class:`Noise`.
        repeats: how often all loads of a pose are applied.
        loads_per_cycle: loads after which the arm is unloaded and zeroed again; None: after all L.
        rotations: record rotations too.
        name: name of the recording, for messages.

    Returns:
        P·repeats·L readings, ordered by pose, repeat, load.

    Raises:
        ValueError: loads for another number of poses, or an arm that cannot support them.
    """
    noise = Noise() if noise is None else noise
    P = len(poses)
    loads = np.broadcast_to(loads, (P, *loads.shape)) if loads.ndim == 2 else loads
    if len(loads) != P:
        raise ValueError(f"loads for {len(loads)} poses, but {P} poses")
    L = loads.shape[1]
    per = L if loads_per_cycle is None else loads_per_cycle
    pose = np.repeat(np.arange(P), repeats * L)
    load = np.tile(np.arange(L), P * repeats)
    again = np.tile(np.repeat(np.arange(repeats), L), P)
    cycle = again * -(-L // per) + load // per
    group = np.unique(np.stack([pose, cycle], axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    q_true = poses[pose]
    wrench = loads[pose, load]
    once = arm.displacement(poses[np.repeat(np.arange(P), L)], loads.reshape(-1, 6)).reshape(P, L, 6)
    true = once[pose, load]
    N, D = len(pose), 6 if rotations else 3
    measured = true[:, :D].copy()
    measured[:, :3] += noise.white * rng.standard_normal((N, 3))
    measured[:, :3] += noise.cycle * rng.standard_normal((group.max() + 1, 3))[group]
    measured[:, :3] += noise.pose * rng.standard_normal((P, 3))[pose]
    if rotations:
        measured[:, 3:] += noise.rotation * rng.standard_normal((N, 3))
    outlier = rng.random(N) < noise.outliers
    away = rng.standard_normal((N, D))
    away[:, :3] *= noise.outlier_size / np.linalg.norm(away[:, :3], axis=1, keepdims=True)
    if rotations:
        away[:, 3:] *= noise.outlier_turn / np.linalg.norm(away[:, 3:], axis=1, keepdims=True)
    measured += np.where(outlier[:, None], away * rng.uniform(0.5, 2.0, (N, 1)), 0.0)
    read = wrench * (1.0 + noise.force * rng.standard_normal((N, 6)))
    q = q_true + noise.joint * rng.standard_normal((P, 6))[pose]
    total = float(np.sqrt(noise.white**2 + noise.cycle**2 + noise.pose**2))
    recording = Recording(
        kind="deflection",
        source=name,
        q=q,
        pose=pose.astype(np.int64),
        cycle=cycle.astype(np.int64),
        session=np.zeros(N, np.int64),
        line=np.arange(2, N + 2),
        wrench=read,
        displacement=measured,
        uncertainty=StandardUncertainty(
            displacement=total or None,
            rotation=noise.rotation or None,
            force=noise.force * float(np.abs(wrench[:, :3]).mean()) or None,
            joint=noise.joint or None,
        )
        if total
        else StandardUncertainty(),
        notes="simulated",
        stated_labels=frozenset({"pose", "cycle"}),
    )
    return Simulated(
        recording=recording,
        q=q_true,
        wrench=wrench,
        displacement=true,
        compliance=arm.compliance_at(poses)[pose],
        outlier=outlier,
    )


def random_loads(
    rng: np.random.Generator, poses: int, loads: int, force: float, moment: float = 0.0, least: float = 0.3
) -> Array:
    """Return loads (P, L, 6) of random direction, between ``least`` and 1 times the full force (N) and moment (N·m)."""
    out = rng.standard_normal((poses, loads, 6))
    for part, size in ((slice(0, 3), force), (slice(3, 6), moment)):
        out[..., part] *= size / np.linalg.norm(out[..., part], axis=-1, keepdims=True)
    return out * rng.uniform(least, 1.0, (poses, loads, 1))


def scattered_poses(robot: Robot, rng: np.random.Generator, count: int, centre: Array, spread: Array | float) -> Array:
    """Return joint angles (count, 6) in rad, uniform within ± ``spread`` rad of ``centre`` (6,), clipped at the
    joint limits."""
    q = centre + rng.uniform(-1.0, 1.0, (count, 6)) * spread
    return np.clip(q, robot.lower, robot.upper)


@dataclass(frozen=True, kw_only=True)
class _Hung:
    """The chain with rotated joints and deflected springs."""

    arm: TrueArm
    z: Array  # (M, 6, 3) joint axes
    o: Array  # (M, 6, 3) points on them
    R: Array  # (M, 7, 3, 3) rotation of each body's far part from q = 0
    p: Array  # (M, 7, 3)
    R_near: Array  # the near parts, before the body's springs
    p_near: Array
    springs: tuple[tuple[Array, Array], ...]  # R_S (M, 3, 3) and origin (M, 3) of each, undeflected
    R_tcp: Array
    p_tcp: Array

    def torque(self, wrench: Array, masses: RobotMasses | None) -> Array:
        """Return the torque (M, 6) in N·m of load and weight about each joint."""
        moment = wrench[:, None, 3:] + np.cross(self.p_tcp[:, None] - self.o, wrench[:, None, :3])
        for at, force, body in self._weights(masses):
            moment[:, :body] += np.cross(at[:, None] - self.o[:, :body], force)
        return np.asarray(np.einsum("mic,mic->mi", self.z, moment))

    def twist(self, n: int, wrench: Array, masses: RobotMasses | None) -> Array:
        """Return the deflection (M, 6) of spring n in its own axes under the load and all weight after it."""
        spring, (R, o) = self.arm.springs[n], self.springs[n]
        force = wrench[:, :3].copy()
        moment = wrench[:, 3:] + np.cross(self.p_tcp - o, wrench[:, :3])
        for at, weight, body in self._weights(masses):
            if body > spring.body:
                force += weight
                moment += np.cross(at - o, weight)
        local = np.concatenate([np.einsum("mji,mj->mi", R, force), np.einsum("mji,mj->mi", R, moment)], axis=1)
        return local @ spring.compliance.T

    def _weights(self, masses: RobotMasses | None) -> list[tuple[Array, Array, int]]:
        """Return for each mass its position (M, 3), its weight (3,) and its body (near part)."""
        if masses is None:
            return []
        return [
            (np.einsum("mij,j->mi", self.R_near[:, b], com) + self.p_near[:, b], m * masses.gravity, int(b))
            for b, m, com in zip(masses.body, masses.mass, masses.com, strict=True)
        ]


def _compute_hanging_state(arm: TrueArm, theta: Array, twists: list[Array]) -> _Hung:
    robot, M = arm.robot, len(theta)
    R, p = np.broadcast_to(np.eye(3), (M, 3, 3)), np.zeros((M, 3))
    z, o = np.empty((M, 6, 3)), np.empty((M, 6, 3))
    far, near = (np.empty((M, 7, 3, 3)), np.empty((M, 7, 3))), (np.empty((M, 7, 3, 3)), np.empty((M, 7, 3)))
    springs: list[tuple[Array, Array]] = [(np.empty(0), np.empty(0))] * len(arm.springs)
    for body in range(7):
        if body:
            i = body - 1
            z[:, i], o[:, i] = R @ robot.axis[i], R @ robot.point[i] + p
            turn = compute_axis_rotation(robot.axis[i], theta[:, i])
            p = p + (R @ (robot.point[i] - turn @ robot.point[i])[..., None])[..., 0]
            R = R @ turn
        near[0][:, body], near[1][:, body] = R, p
        for n, spring in enumerate(arm.springs):
            if spring.body != body:
                continue
            S, s = spring.T_base_spring[:3, :3], spring.T_base_spring[:3, 3]
            springs[n] = (R @ S, R @ s + p)
            break_ = S @ convert_vector_to_rotation(twists[n][:, 3:]) @ S.T  # rotation of the far part, at q = 0
            shift = s + twists[n][:, :3] @ S.T - break_ @ s
            p = p + (R @ shift[..., None])[..., 0]
            R = R @ break_
        far[0][:, body], far[1][:, body] = R, p
    end = robot.T_base_flange_zero @ arm.T_flange_tcp
    return _Hung(
        arm=arm,
        z=z,
        o=o,
        R=far[0],
        p=far[1],
        R_near=near[0],
        p_near=near[1],
        springs=tuple(springs),
        R_tcp=R @ end[:3, :3],
        p_tcp=R @ end[:3, 3] + p,
    )
