"""Work table of a measurement plan, and the empty recording for its readings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from machopt.collision.collision_model import MAX_BOUNDED_STEP_RAD, CollisionModel
from machopt.data_types.measurements.measurement_poses_table import PosesTable
from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.measurement.design.load_methods import LoadMethod
from machopt.measurement.design.measurement_plan import MeasurementPlan
from machopt.measurement.design.pose_candidates import PosePool
from machopt.measurement.design.reading_noise import HOLD, ReadingNoise
from machopt.measurement.design.request import PosesRequest
from machopt.numerics.array_types import Array

BETWEEN = 60.0  # s, time between load cycles in the template


def build_poses_table(
    plan: MeasurementPlan,
    pool: PosePool,
    ways: Sequence[LoadMethod],
    collision: CollisionModel | None,
    home: Array,
    noise: ReadingNoise,
) -> PosesTable:
    """Build the work table with one row per load cycle, in the order of work.

    Args:
        plan: The measurement plan.
        pool: Candidate poses.
        ways: Methods of load application.
        collision: Collision model; None: not checked.
        home: (6,) home position, rad.
        noise: Noise of a reading.

    Returns:
        The table.
    """
    cases = plan.cases
    reading = np.array([v.reading for v in plan.visits])
    poses = cases.pose[reading]
    q = pool.q[poses]
    distinct, back = np.unique(poses, return_inverse=True)
    clearance, free = np.full(len(distinct), np.nan), [None] * len(reading)
    way_free: list[bool | None] = list(free)
    if collision is not None:
        cut = np.zeros(len(distinct), bool)
        clearance = collision.find_nearest_pair(pool.q[distinct], cut).distance
        driven = np.concatenate([home[None], q])
        hit = collision.check_motion(driven, np.zeros(len(driven), bool), MAX_BOUNDED_STEP_RAD).hit
        way_free = [not h for h in hit[1:].tolist()]
    return PosesTable(
        pose=np.array([v.pose + 1 for v in plan.visits]),
        cycle=np.array([v.cycle + 1 for v in plan.visits]),
        session=np.array([v.round + 1 for v in plan.visits]),
        q=q,
        load=tuple(ways[cases.way[n]].describe(cases.magnitude[n]) for n in reading),
        wrench=cases.wrench[reading],
        position=pool.T_base_tcp[poses, :3, 3],
        displacement=cases.twist[reading, : noise.dimensions],
        kci=pool.kci[poses],
        nu_p=cases.nu_p[reading],
        nu_r=cases.nu_r[reading],
        clearance=clearance[back],
        load_point=cases.point[reading],
        way_free=tuple(way_free),
    )


def expand_load_steps(table: PosesTable, steps: Sequence[float]) -> PosesTable:
    """Expand each load cycle to its readings: up to the full load and back.

    Args:
        table: Work table with one row per cycle.
        steps: Shares of the full load at which a load cycle is read.

    Returns:
        The table with one row per reading.
    """
    K = len(steps)
    if K == 1:
        return table
    factor = np.tile(np.array(steps), len(table))
    load = tuple(_format_load_share(f, words) for words in table.load for f in steps)
    spread = {name: np.repeat(value, K, axis=0) for name, value in vars(table).items() if isinstance(value, np.ndarray)}
    first = np.arange(len(factor)) % K == 0
    way_free = tuple(
        free if head else True
        for free, head in zip(np.repeat(np.array(table.way_free, object), K).tolist(), first.tolist(), strict=True)
    )
    return PosesTable(
        **{
            **spread,
            "load": load,
            "way_free": way_free,
            "wrench": spread["wrench"] * factor[:, None],
            "displacement": spread["displacement"] * factor[:, None],
        }
    )


def _format_load_share(factor: float, words: str) -> str:
    if factor == 0.0:
        return "unloaded"
    return words if factor == 1.0 else f"{100 * factor:.0f} % of {words}"


def build_recording_template(
    table: PosesTable, plan: MeasurementPlan, noise: ReadingNoise, request: PosesRequest, steps: Sequence[float] = ()
) -> Recording:
    """Build the recording for the measurements; its displacements are zero.

    Args:
        table: Work table.
        plan: The measurement plan.
        noise: Noise of a reading.
        request: Validated user request.
        steps: Shares of the full load for the rows of a load cycle; empty: each row is a cycle.

    Returns:
        The recording.
    """
    own = float(np.sqrt(noise.reading**2 - noise.pose**2))
    force = np.linalg.norm(table.wrench[:, :3], axis=1)
    return Recording(
        kind="deflection",
        source="recording_template",
        q=table.q,
        pose=table.pose,
        cycle=table.cycle,
        session=table.session,
        line=np.arange(2, len(table) + 2),
        wrench=table.wrench,
        displacement=np.zeros_like(table.displacement),
        **_build_step_columns(table, steps),
        uncertainty=StandardUncertainty(
            displacement=own,
            rotation=None if noise.targets is None else own / noise.targets,
            force=float(noise.force * np.sqrt(np.mean(force**2))) or None,
        ),
        notes=(
            "Each cycle: read the unloaded TCP, load step by step and unload step by step, hold each step as time_s "
            "says and read; enter each reading minus the unloaded one at the start of its cycle, in base_link axes at "
            "the TCP. Replace joints, loads and times by what was really set."
            if len(steps) > 1
            else "Each row: read the unloaded TCP, load, read, unload, read; enter loaded minus the mean of the two "
            "unloaded readings, in base_link axes at the TCP. Replace joints and loads by what was really set."
        ),
        stated_labels=frozenset({"pose", "cycle", "session"}),
    )


def _build_step_columns(table: PosesTable, steps: Sequence[float]) -> dict[str, Any]:
    """Return branch and time of each reading of stepped cycles."""
    K = len(steps)
    if K < 2:
        return {}
    rising = np.arange(K) <= int(np.argmax(np.array(steps)))
    cycles = len(table) // K
    time = np.repeat(np.arange(cycles) * (K * HOLD + BETWEEN), K) + HOLD * np.tile(np.arange(1, K + 1), cycles)
    return {"branch": np.tile(np.where(rising, 1, -1), cycles).astype(np.int8), "time": time.astype(float)}
