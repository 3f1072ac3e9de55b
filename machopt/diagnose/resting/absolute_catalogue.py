"""What measured TCP poses may show beyond the refitted base, and what they cannot.

A zero offset of joint 1 *is* a turn of the tracker frame, one of joint 6 a shift of the target where no orientation is
measured: what the base takes up altogether is not offered but listed as untestable. A step with the sign of a torque
that weight keeps on one side is a zero offset, and offered as such alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws import at_angle, at_beside, at_body, at_flange, at_heat, at_joint, at_sensor, laws_geometry
from machopt.diagnose.nouns.problem import Catalogue, Hypothesis, Problem, Untestable
from machopt.diagnose.nouns.readings import Readings
from machopt.diagnose.resting import unnamed_poses, unweighed
from machopt.domain.location import joint_at, joints_of, located
from machopt.effects import by_angle, geometry, kinematic, registry
from machopt.effects.protocol import timed

BODY = "body"  # family of what gives way
SLIDES = "it slides: it is looked for by its geometry alone, and what gives along it is the base's"
ROUNDING = 1e-8  # of a column's length: what is left of one that the base holds


def catalogue(r: Readings, problem: Problem) -> Catalogue:
    """Every effect that measured poses can show, without those that the base takes up altogether."""
    offered: list[Hypothesis] = [
        *at_angle.hypotheses(r),
        *at_joint.couplings_at_rest(r),
        *laws_geometry.hypotheses(r, problem.base),
        *([*at_flange.at_rest(r), *at_beside.in_poses(r)] if unweighed.weighed(r.masses) else []),
        *at_heat.hypotheses(r),
        *(h for h in at_body.hypotheses(r) if not (r.recording.targets and h.location == "tool")),
    ]
    slides = [] if r.robot.slides is None else [joint_at(int(j) + 1) for j in np.flatnonzero(r.robot.slides)]
    offered = [h for h in offered if h.effect == geometry.EFFECT.name or not _moved_by(h.location, slides)]
    missing = [*(Untestable(kinematic.ZERO.name, where, SLIDES) for where in slides), *_untestable(r)]
    Q = spanned(problem.base)
    turning = np.array([joint_at(j + 1) not in slides for j in range(6)])
    drives = np.quantile(np.abs(r.torque), 0.9, axis=0) * turning
    kinds = [e for e in registry.of_joint_torque() if not e.remembers]
    for j in map(int, np.flatnonzero(turning)):
        where = joint_at(j + 1)
        if drives[j] <= calibrated.RESTING.turned_by_load * max(drives.max(), 1e-12):
            missing.append(Untestable(by_angle.EFFECT.name, where, "neither weight nor load turns it"))
            continue
        beside = _with_offset(Q, r, j)
        for effect in sorted(kinds, key=lambda e: e.laws[0].weighs):
            laws, _ = at_joint.hypotheses(r, j, effect)
            for law, h in ((law, h) for h in laws for law in effect.laws if law.name == h.law):
                shapes = h.shapes
                if law.weighs:
                    shapes = tuple(s for s in shapes if _own(h.columns(s), Q, beside))
                if shapes:
                    offered.append(replace(h, shapes=shapes))
                else:
                    why = "weight keeps its torque on one side: it is a zero offset"
                    missing.append(Untestable(effect.name, where, why, (kinematic.ZERO.name, where)))
    if r.recording.registration == "fixed":
        offered += at_sensor.in_poses(r)
    kept = []
    for h in offered:
        columns = h.columns(h.shapes[len(h.shapes) // 2])
        if h.family == BODY and _needless(columns, Q):
            continue
        if left(columns, Q) > calibrated.RESTING.taken_up:
            kept.append(h)
        elif (h.effect, h.location) not in {(m.effect, m.location) for m in missing}:
            missing.append(Untestable(h.effect, h.location, _taken_up(h, r)))
    axes = {"session": r.session.astype(float)}
    if np.abs(r.wrench).max() > 0.0:
        axes["load"] = np.linalg.norm(r.wrench[:, :3], axis=1)
    for name, values in (("time", r.recording.time), ("temperature", r.recording.temperature)):
        if values is not None:
            axes[name] = values
    p = r.state.T_base_tool[:, :3, 3]
    axes |= {name: p[:, k] for k, name in enumerate("xyz")} | {f"q{j + 1}": r.state.q[:, j] for j in range(6)}
    named = {(h.effect, h.location) for h in kept}
    untestable = tuple(m for m in missing if (m.effect, m.location) not in named)
    finer = tuple(h for h in at_angle.finer_waves(r) if h.name in named)
    return Catalogue(tuple(kept), untestable, axes, finer, tuple(unnamed_poses.hypotheses(r)))


def _moved_by(place: str, slides: list[str]) -> bool:
    """Whether a law sits at joints of which one slides: laws of angles and torques do not hold there."""
    return located(place).of_joints and any(joint_at(j + 1) in slides for j in joints_of(place))


def spanned(columns: Array) -> Array:
    """(N D, K) orthonormal columns of what (N, D, P) can make up, rotations counted by ``calibrated.RESTING.lever``."""
    B = _flat(columns)
    sizes = np.linalg.norm(B, axis=0)
    U, s, _ = np.linalg.svd(B[:, sizes > 0] / sizes[sizes > 0], full_matrices=False)
    return np.asarray(U[:, s > 1e-9 * s[0]] if len(s) else U)


def left(columns: Array, Q: Array) -> float:
    """Share of a hypothesis' columns (N, D, p), by length, that the base's (:func:`spanned`) cannot make up."""
    A = _flat(columns)
    size = float(np.linalg.norm(A))
    return float(np.linalg.norm(A - Q @ (Q.T @ A))) / size if size > 0 else 0.0


def _needless(columns: Array, Q: Array) -> bool:
    """Whether the base takes up some numbers of a law but not all: a law of the same body goes without those.

    A plate that sinks under a weight that is always the same shifts everything, as a fitted tracker frame does.
    """
    each = [left(columns[:, :, [k]], Q) > calibrated.RESTING.taken_up for k in range(columns.shape[2])]
    return any(each) and not all(each)


def _flat(columns: Array) -> Array:
    weight = np.r_[np.ones(3), np.full(columns.shape[1] - 3, calibrated.RESTING.lever)][:, None]
    return np.asarray((columns * weight).reshape(columns.shape[0] * columns.shape[1], columns.shape[2]))


def _with_offset(Q: Array, r: Readings, j: int) -> Array:
    """The span beside a zero offset of joint j; as it was where it holds one already."""
    column = _flat(r.lift(j, np.ones(len(r))))[:, 0]
    rest = column - Q @ (Q.T @ column)
    rest = rest - Q @ (Q.T @ rest)
    size = float(np.linalg.norm(rest))
    return np.column_stack([Q, rest / size]) if size > ROUNDING * float(np.linalg.norm(column)) else Q


def _own(columns: Array, Q: Array, beside: Array) -> bool:
    """A law on a joint's torque shows more in these poses than a zero offset of the joint would."""
    alone = left(columns, Q)
    return alone > calibrated.RESTING.taken_up and left(columns, beside) > calibrated.RESTING.distinct * alone


def _untestable(r: Readings) -> list[Untestable]:
    out = [
        Untestable("geometric_stiffness", "arm", "counted exactly: the arm is in equilibrium where it really stands")
    ]
    for effect in registry.of_joint_torque():
        if effect.remembers:
            how = (
                "since when the torque has been there"
                if timed(effect.laws[0])
                else ("how the torque came there; load cycles do")
            )
            out.append(Untestable(effect.name, effect.places[0], f"measured poses do not say {how}"))
    if not unweighed.weighed(r.masses):
        lacks = unweighed.of_links(r.masses)
        out += [
            Untestable("payload", "tool", f"{lacks}; with them weight would show it"),
            Untestable("gravity_compensator", "joint:2", f"{lacks} to tell its torque from weight"),
        ]
    if r.recording.targets:
        out.append(Untestable("tool_compliance", "tool", "the reflectors sit on the flange, before the tool gives way"))
    if r.recording.time is None and r.recording.temperature is None:
        out.append(Untestable("thermal_drift", "environment", "the recording has neither time_s nor temperature_C"))
    return out


def _taken_up(h: Hypothesis, r: Readings) -> str:
    if h.effect in ("joint_zero_offset", "joint_coupling") and h.location == "joint:1":
        return "it turns everything about an axis that stands still: the fitted tracker frame takes it up"
    if h.effect == "joint_zero_offset" and h.location == "joint:6" and r.dimensions == 3 and not r.recording.targets:
        return "it shifts the target in the flange, which is fitted; measured orientations would show it"
    if h.effect == "joint_zero_offset" and h.location == "joint:6":
        return "it turns all reflectors about one axis, and their places in the flange are fitted"
    return "what is refitted in any case takes it up altogether in these poses"
