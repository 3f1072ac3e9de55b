"""Joint torques in motion against rigid-body dynamics from the URDF's inertias and the cell's tool.

y = τ − RNEA(q, q̇, q̈). Refitted in any case, for each joint: offset, Coulomb and viscous friction and the inertia of
its motor (no URDF states it), and one rotational inertia of the tool (no cell states it); of currents without a
gain this too. The links' masses are the
URDF's to a share (``link_scale``), within which a scale of each is refitted, unless a payload is the better reason;
where the data say plainly that several links are off, which no payload explains, it is said.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws import at_beside, at_flange
from machopt.diagnose.laws.motion_frame import Scene, one_joint
from machopt.diagnose.moving import drives, unnamed_motions
from machopt.diagnose.moving.clock import LONGEST, clocks, valley
from machopt.diagnose.moving.friction import Turn, breakaway, direction, friction, gradual, rest_of, turned, unsure
from machopt.diagnose.moving.loads import ripple, springy
from machopt.diagnose.moving.masses import links_of, spread_of
from machopt.diagnose.nouns.problem import Catalogue, Family, Hypothesis, Ints, Problem, Unknown, Untestable
from machopt.domain.location import column_at, joint_at, link_at
from machopt.errors import InputError

# late friction and a long breakaway path look alike at one joint
APART = 1_000_000  # s between sessions, whose clocks may begin anew
CLOCK_TURNS = ((0.0, 0.0), (5e-5, 0.0), (2e-4, 0.0), (0.0, 0.01), (0.0, 0.05))


def build(scene: Scene) -> tuple[Problem, Catalogue]:
    """Equations and catalogue of the channel torque.

    Raises:
        InputError: no torque, or no inertias in the URDF.
    """
    m, dynamics, rec = scene.motion, scene.dynamics, scene.recording
    if dynamics is None or scene.predicted is None or rec.torque is None:
        raise InputError(f"{rec.source}: the channel torque needs tau1_Nm … and a URDF with inertias")
    n = scene.joints
    measured = rec.torque[m.index, :n]
    needed = scene.predicted
    y = m.within(m.mean(measured - needed))
    P, T, L = dynamics.regressors(m.q, m.v, m.a)
    # a spring that the cell does not state is out of step with the rigid bodies too
    best, shared, rough = _clock(scene, measured, m.mean(np.concatenate([P, at_beside.shapeless(m.q)], axis=2)))
    # a delay that one joint alone asks for is made up of its own friction, and would smooth the reversals of all
    aligned = m.within(m.mean(m.late(measured, -best) - scene.predicted)) if shared else y
    # what a payload and links of other masses ask for is no friction
    own = m.within(m.mean(np.concatenate([P, L], axis=2))) if n > 1 else np.zeros((len(aligned), n, 0))
    paths = [breakaway(scene, j, aligned[:, j], own[:, j]) if scene.moves(j) else CLOCK_TURNS[0] for j in range(n)]
    gradually = [gradual(scene, j, paths[j], aligned[:, j], own[:, j]) if scene.moves(j) else "" for j in range(n)]
    base, unknowns = _base(scene, paths, gradually)
    if n > 1:
        scale = _alike(y, base, m.segment[m.starts][m.keep])
        scene = replace(scene, scale=scale, lift=one_joint(m, n, scale=scale))
        y = y * scale
        base = base * scale[:, None]
        scene.notes.append(
            "torques are weighted by the noise of each joint: where only noise is left the error is the "
            "rms over joints in N·m; 1 N·m counts " + ", ".join(f"{s:.3g}" for s in scale) + " at joints 1 … " + str(n)
        )
    load = P
    P, T, L = (scene.everywhere(x) for x in (P, T, L))
    if np.abs(T).max() > 1e-9 and dynamics.tool_mass > 0:
        base = np.concatenate([base, T], axis=2)
        unknowns.append(
            Unknown(name="tool inertia", unit="kg·m²", location="tool", unstated="inertia about its centre")
        )
    if n > 1:
        balancer = [h.columns(h.shapes[0]) for h in at_beside.in_torques(scene)[:1]]
        gains = [] if scene.free_gains else [scene.column(j, needed[:, j]) for j in range(n) if scene.moves(j)]
        doubt, said = links_of(y, base, P, np.concatenate([P, *balancer, *gains], axis=2), L, m.group)
        scene.notes.extend(said)
        if doubt > 0.0:
            base = np.concatenate([base, L], axis=2)
            unknowns += [
                Unknown(name=f"mass of link {b + 1}, relative", unit="1", location=link_at(b + 1), prior=doubt)
                for b in dynamics.bodies
            ]
    problem = scene.problem(
        "torque",
        y,
        base,
        unknowns,
        Family(name="joint torque", columns=tuple(range(n)), unit="N" if all(scene.prismatic) else "N·m", factor=1.0),
    )
    carried = {} if n == 1 or scene.free_gains else drives.loaded(scene, y, base, load, P)
    return problem, _catalogue(scene, P, paths, best, rough, (aligned, own, carried))


def _base(scene: Scene, paths: list[Turn], gradually: Sequence[str] = ()) -> tuple[Array, list[Unknown]]:
    """What is refitted in any case, and what it is; ``gradually`` of each joint how its friction surely turns over."""
    m, n = scene.motion, scene.joints
    parts, unknowns = [], []
    for j in range(n):
        place, unit = joint_at(j + 1), "N" if scene.prismatic[j] else "N·m"
        speed, mass = ("N·s/m", "kg") if scene.prismatic[j] else ("N·m·s/rad", "kg·m²")
        signals = [np.ones(len(m.q))]
        unknowns.append(Unknown(name=f"offset {j + 1}", unit=unit, location=place))
        if scene.moves(j):
            signals += [direction(scene, j, paths[j]), m.v[:, j], m.a[:, j]]
            unknowns += [
                Unknown(
                    name=f"Coulomb friction {j + 1}",
                    unit=unit,
                    location=place,
                    unstated=gradually[j] if gradually else "",
                ),
                Unknown(name=f"viscous friction {j + 1}", unit=speed, location=place),
                Unknown(name=f"motor inertia {j + 1}", unit=mass, location=place, unstated="motor inertia"),
            ]
            if scene.free_gains and scene.predicted is not None:
                signals.append(scene.predicted[:, j])
                unknowns.append(Unknown(name=f"gain of current {j + 1} beyond the first", unit="1", location=place))
            more = unsure(scene, j, paths[j])
            signals += more
            unknowns += [
                Unknown(name=f"turn-over of friction {j + 1}, {k + 1}", unit=unit, location=place)
                for k in range(len(more))
            ]
        parts.append(scene.column(j, np.stack(signals, axis=1)))
    return np.concatenate(parts, axis=2), unknowns


def _alike(y: Array, base: Array, segment: Ints) -> Array:
    """(D,) factors that give every joint's torque the same noise, their rms kept: noise from neighbouring readings."""
    sigma = np.empty(y.shape[1])
    inside = np.diff(segment) == 0
    for j in range(y.shape[1]):
        step = np.diff(rest_of(y[:, j], base[:, j])[0])[inside]
        sigma[j] = 1.4826 * float(np.median(np.abs(step - np.median(step)))) / np.sqrt(2.0)
    sigma = np.maximum(sigma, 1e-6 * max(float(sigma.max()), 1e-12))
    return np.asarray(np.sqrt(np.mean(sigma**2)) / sigma)


def _clock(scene: Scene, measured: Array, load: Array) -> tuple[float, bool, Callable[[float], Array]]:
    """How late the torques are (s), each joint's friction and motor inertia refitted at every delay; whether most
    joints are surely the better for it; and the torque (M, n) that they should have shown, late by any d.

    Friction steps where a joint reverses, so it has to be late together with the rigid bodies. A load at the flange, or
    a spring beside a gear, that the cell does not state asks for torque out of step with what is predicted, as a clock
    does: ``load`` (N, n, p), what they would ask for, is refitted beside. What a joint shows about its reversals is
    left out: encoders that step, or dwell, tell their moment late, and friction turns over early or late by laws of its
    own.
    """
    m = scene.motion
    assert scene.predicted is not None
    predicted = scene.predicted
    moving = [j for j in range(scene.joints) if scene.moves(j)]
    tau = m.within(m.mean(measured))
    at = m.mean(m.time + APART * m.session)
    under_way = {j: _under_way(scene, j) for j in moving}

    def carried(d: float, j: int) -> Array:
        """(N, p) of the load, late; it is smooth, so that averages will do."""
        return m.within(np.stack([np.interp(at - d, at, x) for x in load[:, j].T], axis=1))

    def smooth(d: float) -> tuple[Array, Array, Array]:
        return m.late(predicted, d), m.late(m.v, d), m.late(m.a, d)

    def turning(v: Array, j: int, k: int, d: float) -> Array:
        if k < len(CLOCK_TURNS):  # from the late speed: a late step between two samples would come out as a ramp
            return turned(scene, v[:, j], CLOCK_TURNS[k])
        # as it does where a recorder brings two clocks together by straight lines between samples
        return m.between(turned(scene, m.v[:, j], CLOCK_TURNS[k - len(CLOCK_TURNS)]), d)

    def parts(
        d: float, j: int, late: tuple[Array, Array, Array], turns: int = len(CLOCK_TURNS)
    ) -> tuple[Array, Array, Array]:
        """(N,) torque of a joint less the rigid bodies', what is refitted beside (N, p), friction by path (N, k)."""
        body, v, a = late
        z = [turning(v, j, k, d) for k in range(turns)]
        signals = (body[:, j], np.ones(len(v)), v[:, j], a[:, j], *z)
        X = m.within(np.stack([m.mean(x) for x in signals], axis=1))
        return tau[:, j] - X[:, 0], np.concatenate([X[:, 1:4], carried(d, j)], axis=1), X[:, 4:]

    def left(d: float) -> list[float]:
        """Mean square that each moving joint leaves while under way, by the breakaway path that leaves least."""
        late, out = smooth(d), []
        for j in moving:
            y, beside, z = (x[under_way[j]] for x in parts(d, j, late))
            size = np.linalg.norm(beside, axis=0)
            Q, _ = np.linalg.qr(beside[:, size > 0] / size[size > 0])
            y, z = (x - Q @ (Q.T @ x) for x in (y, z))
            gains = (y @ z) ** 2 / np.maximum(np.sum(z**2, axis=0), 1e-300)
            out.append(float(y @ y - gains.max()) / len(y))
        return out

    power = np.array(left(0.0))

    def misfit(d: float) -> float:
        return float(np.sum(np.log(np.maximum(left(d), 0.0) + 1e-6 * power)))

    best = valley(misfit) if moving else 0.0
    # a clock that says next to nothing would still smear each reversal over some samples
    worth = len(tau) * (misfit(0.0) - misfit(best)) >= calibrated.DETECTION.gain
    shared = worth and 2 * int(np.sum(np.array(left(best)) < power)) > len(moving)
    fitted, late = [], smooth(best)
    for j in moving:
        y, beside, z = parts(best, j, late, 2 * len(CLOCK_TURNS))
        each = [
            (*rest_of(y, np.concatenate([beside[:, :3], x[:, None], beside[:, 3:]], axis=1)), k)
            for k, x in enumerate(z.T)
        ]
        fitted.append(min(each, key=lambda f: float(f[0] @ f[0])))

    def rough(d: float) -> Array:
        body, v, a = smooth(d)
        out = body.copy()
        for j, (_, x, k) in zip(moving, fitted, strict=True):
            out[:, j] += x[0] + x[1] * v[:, j] + x[2] * a[:, j] + x[3] * turning(v, j, k, d)
        return out

    return best, shared, rough


def _under_way(scene: Scene, joint: int) -> NDArray[np.bool_]:
    """(N,) readings about which a joint keeps its way by more than the longest delay; all, where these are few."""
    m = scene.motion
    v = m.mean(m.v[:, joint])
    fast = float(np.quantile(np.abs(v), 0.9)) * calibrated.MOTION.under_way
    window = 2 * int(np.ceil(LONGEST / max(float(np.median(np.diff(m.mean(m.time)))), 1e-6))) + 1
    low, high = minimum_filter1d(v, window), maximum_filter1d(v, window)
    out = (low > fast) | (high < -fast)
    return out if out.mean() > calibrated.MOTION.mostly_under_way else np.ones(len(v), bool)


def _catalogue(
    scene: Scene,
    P: Array,
    paths: list[Turn],
    best: float,
    rough: Callable[[float], Array],
    drive: tuple[Array, Array, Mapping[int, Array]],
) -> Catalogue:
    """``drive``: what laws of drives are held against, see :func:`machopt.diagnose.moving.drives.hypotheses`."""
    n = scene.joints
    out: list[Hypothesis] = []
    assert scene.dynamics is not None  # build asks
    inertia = scene.dynamics.own_inertia(scene.motion.q)
    untestable: list[Untestable] = []
    for j in range(n):
        if j in scene.unsized:
            untestable.append(Untestable("joint_friction", joint_at(j + 1), "nothing says what torque its current is"))
            continue
        if scene.free_gains:
            untestable.append(
                Untestable("units", column_at(f"tau{j + 1}_Nm"), "a gain of each current is refitted anyway")
            )
        out += friction(scene, j, paths[j])
        out += ripple(scene, j)
        out += springy(scene, j, inertia)
    if n > 1:
        out += at_flange.in_motion(scene, P)
        out += at_beside.in_torques(scene)
        out += drives.hypotheses(scene, paths, *drive)
    else:
        untestable.append(Untestable("payload", "tool", "one joint cannot tell a payload from its own inertia"))

    now = rough(0.0)

    def late(d: float) -> Array:
        return scene.everywhere(rough(d) - now)

    out += clocks(scene, "tau", late, best)
    out += clocks(scene, "q", late, best, sign=-1.0, penalty=2.0)
    nameless = tuple(h for j in range(n) for h in unnamed_motions.hypotheses(scene, j))
    return Catalogue(tuple(out), tuple(untestable), motion_axes(scene), nameless=nameless)


def gear_load(scene: Scene) -> Array | None:
    """Torque (M, n) of the link side by rigid bodies, a payload refitted to the recorded torque where there is one.

    None where that does not describe the recorded torque to a tenth, or the URDF has no inertias.
    """
    m, dynamics = scene.motion, scene.dynamics
    if dynamics is None or scene.predicted is None:
        return None
    if scene.recording.torque is None:
        return scene.predicted
    measured = scene.recording.torque[m.index, : scene.joints]
    y = m.within(m.mean(measured - scene.predicted))
    base, unknowns = _base(scene, [CLOCK_TURNS[1]] * scene.joints)
    P, T, _ = dynamics.regressors(m.q, m.v, m.a)
    own = np.concatenate([P, T], axis=2)
    X = np.concatenate([base, scene.everywhere(own)], axis=2)
    weight = 1.0 / np.maximum(spread_of(y, base), 1e-12)
    A = (X * weight[:, None]).reshape(-1, X.shape[2])
    left, x = rest_of((y * weight).reshape(-1), A)
    error = np.std(left.reshape(y.shape) / weight, axis=0)
    moving = [j for j in range(scene.joints) if scene.moves(j)]
    if any(error[j] > calibrated.MOTION.describes * np.ptp(measured[:, j]) for j in moving):
        return None
    return np.asarray(scene.predicted + own @ x[len(unknowns) :])


def motion_axes(scene: Scene) -> dict[str, Array]:
    m = scene.motion
    out = {"time": m.mean(m.time), "session": m.first(m.session).astype(float)}
    for j in range(scene.joints):
        out[f"q{j + 1}"] = m.mean(m.q[:, j])
        out[f"speed {j + 1}"] = m.mean(m.v[:, j])
    if scene.recording.temperature is not None:
        out["temperature"] = m.mean(scene.recording.temperature[m.index])
    return out
