"""As-built geometry in measured poses: a twist of each joint's frame in the preceding link.

A twist (d, φ) of the frame at p moves the TCP by d + φ × (x − p), in axes carried by the preceding links. Of its six
components only those are searched that the poses show in addition to the base: the singular directions of the
columns, scaled by manufacturing tolerances, with a sufficient part outside of the span of the base. Source: Hayati &
Mirmirani 1985; Meggiolaro & Dubowsky 2000 (redundant components of neighbouring frames).
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.effects import prior_scales
from machopt.effects.protocol import JOINTS, Quantity
from machopt.effects.structure import as_built_joint_frames
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Quantities, Shape
from machopt.measurement.diagnosis.data_types.static_readings import BODY_BEHIND_FLANGE, StaticReadings
from machopt.numerics.array_types import Array

WHOLE_ARM_FRAMES = (
    "base",
    "joint:1",
)  # move all points equally, like an error of the recorded tracker frame


def compute_frame_columns(r: StaticReadings, place: str) -> Array:
    """Compute the change of the readings per unit twist of a frame.

    Args:
        r: Static readings.
        place: Frame: ``base``, ``joint:1`` to ``joint:n``, or ``tool``.

    Returns:
        (N, D, 6) m, rad per m and rad, axes of base_link with all joints at zero.

    Raises:
        ValueError: The state has no body poses.
    """
    n = len(r)
    joint = JOINTS.index(place) if place in JOINTS else 0
    link = r.joint_count if place == as_built_joint_frames.TOOL else joint
    if r.state.R_bodies is None or r.state.p_bodies is None:
        raise ValueError("the state was made without its bodies")
    R, p = r.state.R_bodies[:, link], r.state.p_bodies[:, link]
    flange = r.robot.T_base_flange_zero[:3, 3]
    origin = {as_built_joint_frames.BASE: np.zeros(3), as_built_joint_frames.TOOL: flange}.get(place)
    at = R @ (r.robot.point[joint] if origin is None else origin) + p
    out = np.zeros((n, 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = R
    lever = r.state.T_base_tool[:, :3, 3] - at
    out[:, :3, 3:] = np.swapaxes(np.cross(np.swapaxes(R, 1, 2), lever[:, None]), 1, 2)
    return r.project_to_measured(
        out, BODY_BEHIND_FLANGE if place == as_built_joint_frames.TOOL else link + 1 if place in JOINTS else 0
    )


def build_geometry_hypotheses(r: StaticReadings, base: Array) -> list[EffectHypothesis]:
    """Build the geometry of each joint frame; with fixed registration also of base and tool.

    A rotation about the joint's own axis is its zero offset, which is a law of its own, and not part of its frame.

    Args:
        r: Static readings.
        base: (N, D, P) base columns.

    Returns:
        The hypotheses.
    """
    places = r.list_places(JOINTS if r.recording.registration == "fit" else as_built_joint_frames.EFFECT.places)
    out = []
    for place in places:
        columns = compute_frame_columns(r, place) * list_manufacturing_tolerances()
        V = find_observable_directions(columns, _append_zero_offset(r, place, base))
        if V.shape[1]:
            beside_frame = place in WHOLE_ARM_FRAMES and r.recording.registration == "fixed"
            out.append(
                _build_frame_hypothesis(place, columns, V, thresholds.LEVELS.gain_three_sigma if beside_frame else 0.0)
            )
    return out


def _append_zero_offset(r: StaticReadings, place: str, base: Array) -> Array:
    if place not in JOINTS:
        return base
    return np.concatenate([base, r.lift_joint_twist(JOINTS.index(place), np.ones((len(r), 1)))], axis=2)


def find_observable_directions(columns: Array, base: Array) -> Array:
    """Find the directions of scaled twists that the base does not absorb, by SVD of the projected columns.

    Args:
        columns: (N, D, 6) columns of the frame twist, scaled by tolerances.
        base: (N, D, P) base columns.

    Returns:
        (6, K) orthonormal directions.
    """
    A = columns.reshape(-1, 6)
    B = base.reshape(len(A), base.shape[2])  # zero columns are dropped
    size = np.linalg.norm(B, axis=0)
    B = B[:, size > 0] / size[size > 0]
    Q = np.linalg.qr(B)[0] if B.shape[1] else B
    _, s, Vt = np.linalg.svd(np.linalg.qr(A - Q @ (Q.T @ A))[1])
    whole = np.linalg.norm(A @ Vt.T, axis=0)
    is_observable = (s > thresholds.SHARES.negligible * whole) & (s > thresholds.SHARES.negligible * s[0])
    return np.asarray(np.round(Vt[is_observable], 12).T)  # removes rounding residue of absorbed components


def _build_frame_hypothesis(place: str, columns: Array, V: Array, penalty: float) -> EffectHypothesis:
    mixed = columns @ V

    def correction(x: Array, shape: Shape) -> KinematicCorrection:
        return KinematicCorrection(
            as_built_joint_frames.EFFECT.name,
            place,
            as_built_joint_frames.write_frame_offset(_compute_frame_offset(V, x)),
        )

    return EffectHypothesis(
        effect=as_built_joint_frames.EFFECT.name,
        location=place,
        law="frame elsewhere",
        equation="x ← x + d + φ × (x − p) behind the joint's frame (Hayati & Mirmirani 1985)",
        columns=lambda shape: mixed,
        quantities=_build_quantities(V),
        correction=correction,
        family="kinematic",
        note=as_built_joint_frames.EFFECT.note,
        penalty=penalty,
        prior_sigma=prior_scales.FRAME_DOUBT.scale,
        is_exact=True,
    )


def _compute_frame_offset(V: Array, x: Array) -> as_built_joint_frames.FrameOffset:
    twist = list_manufacturing_tolerances() * (V @ x)
    return as_built_joint_frames.FrameOffset(twist[:3], twist[3:])


def _build_quantities(V: Array) -> Quantities:
    def quantities(x: Array, shape: Shape) -> dict[str, Quantity]:
        p = _compute_frame_offset(V, x)
        out = {"size": Quantity(float(np.linalg.norm(V @ x) * 1e3 * prior_scales.FRAME_SHIFT.scale), "mm")}
        out |= {f"shift {a}": Quantity(float(v), "mm") for a, v in zip("xyz", 1e3 * p.shift, strict=True)}
        return out | {f"turn {a}": Quantity(float(v), "mrad") for a, v in zip("xyz", 1e3 * p.turn, strict=True)}

    return quantities


def list_manufacturing_tolerances() -> Array:
    """Return the manufacturing tolerances (6,) of a frame as standard deviations, m and rad."""
    return np.repeat([prior_scales.FRAME_SHIFT.scale, prior_scales.FRAME_ROTATION.scale], 3)
