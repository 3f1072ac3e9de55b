"""Proposal of the next motion to record: the one within the arm's limits whose signals separate the rivals most.

Each candidate is simulated as a recording of the refitted arm with the observed scatter. Its merit is the part of the
reported law that remains after fitting base and rival.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.effect_locations import parse_joint_location, parse_location
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.rigid_body import MissingInertiaError, load_dynamics
from machopt.effects.effect_wording import format_effect_in_sentence
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem, HypothesisCatalogue
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, Finding
from machopt.measurement.diagnosis.dynamic import motion_channels
from machopt.measurement.diagnosis.dynamic.friction import fit_least_squares
from machopt.numerics.array_types import Array

SECONDS, RATE = 30.0, 50.0  # s, Hz of a candidate motion
SPEEDS = {
    "slowly": 0.03,
    "at a sixth of its speed": 0.167,
    "at half its speed": 0.5,
}  # relative to the joint's largest speed
MOTION_AMPLITUDES = (np.radians(5.0), np.radians(45.0))  # rad in either direction
JOINT_LIMIT_MARGIN = np.radians(5.0)  # rad, margin to the joint limits
MOST_RIVALS, MOST_SHAPES = 3, 8


@dataclass(frozen=True)
class CandidateMotion:
    """Candidate motion: (M, n) rad, rad/s, rad/s² at times (M,) s."""

    words: str
    time: Array
    q: Array
    v: Array
    a: Array


def suggest_next_motion(cell: Cell, channel: motion_channels.MotionChannel, d: DiagnosisResult) -> str:
    """Describe the next motion to record in words that allow programming it.

    Args:
        cell: Robot cell.
        channel: Channel of the diagnosis.
        d: Result of the diagnosis.

    Returns:
        Text.
    """
    sets = [f for f in d.findings if len(f.one_of) > 1 and not f.record and f.rivals]
    if sets:
        return _describe_separating_motion(cell, channel, d, sets[0])
    if d.verdict == "unexplained":
        place = next((s.axis for s in d.mismatch if s.kind == "machine"), "the arm")
        return (
            f"Record {place} by itself, slowly and fast, to and fro over its range with the others at rest, once more "
            "with another load at the flange: what changes with speed, angle and load says which law is missing."
        )
    if d.findings:
        f = d.findings[0]
        return (
            f"Confirm {format_effect_in_sentence(f.effect, f.location)} on another day, along a motion "
            f"through other poses."
        )
    return "None needed for the effects above their detection limits; smaller ones need more periods of the motion."


def _describe_separating_motion(
    cell: Cell, channel: motion_channels.MotionChannel, d: DiagnosisResult, f: Finding
) -> str:
    others = ", ".join(format_effect_in_sentence(*n) for n in f.one_of[1 : 1 + MOST_RIVALS])
    head = f"To tell {format_effect_in_sentence(f.effect, f.location)} from {others}: "
    best: tuple[float, str] | None = None
    for one in generate_candidate_motions(
        cell, parse_joint_location(f.location)[0] if parse_location(f.location).is_joint_location else None
    ):
        try:
            power = _compute_rival_separation(cell, channel, d, f, one)
        except (InputError, MissingInertiaError):  # the motion does not provide this channel
            continue
        if best is None or power > best[0]:
            best = power, one.words
    if best is None or best[0] < thresholds.LEVELS.gain_three_sigma:
        return (
            f"{head}no motion within the arm's limits does, of those that were tried; another load at the flange, or "
            "a sensor behind the joint, would."
        )
    return (
        f"{head}{best[1]}. In {SECONDS:g} s the rivals then part by {np.sqrt(best[0]):.0f} standard deviations of the "
        "scatter found here; the joints' limits are kept, collisions are yours to check."
    )


def generate_candidate_motions(cell: Cell, joint: int | None) -> Iterator[CandidateMotion]:
    """Generate oscillating motions within the limits of position, speed and acceleration, of one joint and of all.

    Args:
        cell: Robot cell.
        joint: Joint index, 0-based; None for all joints.

    Returns:
        Iterator over the candidates.
    """
    n = len(cell.arm_joints)
    t = np.arange(int(SECONDS * RATE)) / RATE
    low, high = cell.limits.lower[:n] + JOINT_LIMIT_MARGIN, cell.limits.upper[:n] - JOINT_LIMIT_MARGIN
    home = np.clip(cell.home[:n], low, high)
    for j in range(n) if joint is None else [joint]:
        for reach in MOTION_AMPLITUDES:
            size = min(reach, 0.5 * (high[j] - low[j]))
            middle = float(np.clip(home[j], low[j] + size, high[j] - size))
            for how, share in SPEEDS.items():
                turn = np.zeros(n)
                turn[j] = size
                position = home.copy()
                position[j] = middle
                w = _compute_swing_rate(cell, turn, share)
                way = f"between {_format_degrees(middle - size)} and {_format_degrees(middle + size)} {how}"
                yield _build_wave_motion(
                    f"drive joint {j + 1} {way} (at most {np.degrees(w * size):.2g}°/s), the others at rest",
                    t,
                    position,
                    turn,
                    w,
                )
    sizes = np.minimum(MOTION_AMPLITUDES[1], 0.5 * (high - low))
    centre = np.clip(home, low + sizes, high - sizes)
    yield _build_wave_motion(
        "drive all joints at once, each to its own beat",
        t,
        centre,
        sizes,
        _compute_swing_rate(cell, sizes, 0.5),
        beat=True,
    )


def _format_degrees(x: float) -> str:
    return f"{np.degrees(x):.0f}°"


def _compute_swing_rate(cell: Cell, size: Array, share: float) -> float:
    """Return the angular frequency (rad/s) at which no joint exceeds that share of its speed, nor its acceleration."""
    n = len(size)
    moved = size > 0.0
    fast = float(np.min(share * cell.limits.velocity[:n][moved] / size[moved]))
    return min(fast, float(np.sqrt(np.min(cell.limits.acceleration[:n][moved] / size[moved]))))


def _build_wave_motion(
    words: str, t: Array, middle: Array, size: Array, w: float, *, beat: bool = False
) -> CandidateMotion:
    share = 1.0 / (1.0 + 0.17 * np.arange(len(size))) if beat else np.ones(len(size))
    phase = w * share * t[:, None]
    q, v, a = middle + size * np.sin(phase), size * w * share * np.cos(phase), -size * (w * share) ** 2 * np.sin(phase)
    return CandidateMotion(words, t, q, v, a)


def _compute_rival_separation(
    cell: Cell, channel: motion_channels.MotionChannel, d: DiagnosisResult, f: Finding, one: CandidateMotion
) -> float:
    """Return the least sum of squares of the reported law that a rival leaves along a motion, relative to the noise
    variance.
    """
    problem, catalogue = _simulate_recording(cell, channel, d, one)
    named, fit = (f.effect, f.location), f.rivals[0].named
    own = next((h for h in catalogue.hypotheses if h.name == named and h.law == f.law), None)
    if own is None or fit is None:
        return 0.0
    made = (own.columns(tuple(fit.shape)) @ np.array(fit.coefficients)).reshape(-1)
    base = problem.base.reshape(len(made), -1)
    sigma = d.noise_floor / problem.families[0].factor
    least = np.inf
    for name in f.one_of[1 : 1 + MOST_RIVALS]:
        for h in (h for h in catalogue.hypotheses if h.name == name):
            for shape in h.shapes[:: max(1, len(h.shapes) // MOST_SHAPES)]:
                X = np.concatenate([base, h.columns(shape).reshape(len(made), -1)], axis=1)
                least = min(least, float(np.sum(fit_least_squares(made, X)[0] ** 2)))
    return least / sigma**2 if np.isfinite(least) else 0.0


def _simulate_recording(
    cell: Cell, channel: motion_channels.MotionChannel, d: DiagnosisResult, one: CandidateMotion
) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
    rng, rows = np.random.default_rng(0), np.arange(len(one.time))
    none = np.zeros(len(rows), np.int64)
    scatter = d.noise_floor * (1.0 if channel == "torque" else 1e-3)  # N·m; mrad, mm
    bare = Recording(
        kind="motion", source="planned", q=one.q, pose=none, cycle=rows, session=none, line=rows + 2,
        time=one.time, velocity=one.v,
        torque=load_dynamics(cell).compute_torque(one.q, one.v, one.a) + scatter * rng.normal(size=one.q.shape)
        if channel == "torque" else None,
    )  # fmt: skip
    if channel == "link":
        bare = replace(bare, q_secondary=one.q + scatter * rng.normal(size=one.q.shape))
    if channel == "tip":
        tip = load_robot(cell).compute_fk(one.q, cell.tool.T_flange_tcp)[:, :3, 3]
        bare = replace(bare, position=tip + scatter * rng.normal(size=tip.shape))
    return motion_channels.build_motion_problem(bare, cell, channel, rng)[:2]
