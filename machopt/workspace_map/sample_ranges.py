"""Ranges and steps of a map's samples: as requested, or defaults."""

from __future__ import annotations

from math import degrees, radians

import numpy as np

from machopt.data_types.cell import Cell
from machopt.errors import OptionError
from machopt.numerics.rigid_transforms import invert_transform
from machopt.workspace_map.postures import ReachingArm, build_tool_poses, compute_candidates
from machopt.workspace_map.request import MapOptions
from machopt.workspace_map.sample_grid import (
    XYZ,
    MapSamples,
    SampleAxis,
    build_even_values,
    build_joint_grid,
    build_position_grid,
    build_straight_line,
    compute_farthest_reach,
    trim_axis,
)

DEFAULT_POSES = 150_000  # samples × rotations without a given step: takes seconds
DEFAULT_SAMPLES = 20_000
MAX_POSES = 4_000_000  # about a minute
MAX_SAMPLES = 100_000  # the page stays below 20 MB
LINE_SAMPLES = 401
CURVE_SAMPLES = 721  # of a single joint
NICE_STEPS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
_PROBE = {"slice": 37, "volume": 19}  # coarse samples along each axis that find the reachable range
_PROBE_ROTATIONS = 8


def build_samples(cell: Cell, arm: ReachingArm, options: MapOptions) -> MapSamples:
    """Return the samples in the map's frame.

    Args:
        cell: robot cell.
        arm: kinematics, limits, margins.
        options: map options.

    Raises:
        InputError: a step leaves one sample, or there would be too many samples.
    """
    if options.kind == "line":
        return _build_line_samples(options)
    ranges = dict(options.ranges)
    if options.kind == "joints":
        for name, joint in zip(options.axes, options.joints, strict=True):
            ranges.setdefault(name, (float(cell.limits.lower[joint]), float(cell.limits.upper[joint])))
    elif len(ranges) < len(options.axes):
        ranges = {**_find_reached_box(arm, options), **ranges}
    spans = {name: ranges[name] for name in options.axes}
    steps = _choose_default_steps(spans, options)
    rotations = 1 if options.kind == "joints" else len(options.gamma) + 1
    _check_sample_count(spans, steps, rotations, options)
    axes = []
    for name in options.axes:
        (low, high), step = spans[name], steps[name]
        values = build_even_values(low, high, step)
        if len(values) < 2:
            raise OptionError(
                f"a step of {_format_value(step, options)} leaves one sample of {name}, from "
                f"{_format_value(low, options)} to "
                f"{_format_value(high, options)}; {_format_value((high - low) / 2, options)} or less would work",
                where="--step",
            )
        axes.append(SampleAxis(name, "rad" if options.kind == "joints" else "m", values))
    if options.kind == "joints":
        return build_joint_grid(tuple(axes), options.joints, options.q)
    fixed = np.zeros(3)
    for c, name in enumerate(XYZ):
        if name not in options.axes:
            fixed[c] = options.at
    return build_position_grid(options.kind, tuple(axes), fixed)


def _build_line_samples(options: MapOptions) -> MapSamples:
    if options.line is None:
        raise ValueError("a line has two ends")
    start, end = options.line
    length = float(np.linalg.norm(end - start))
    step = options.steps.get("s", options.steps.get(""))
    count = LINE_SAMPLES if step is None else int(np.ceil(length / step - 1e-9)) + 1
    if count < 2 or count * len(options.gamma) > MAX_POSES or count > MAX_SAMPLES:
        raise OptionError(
            f"a step of {1e3 * (step or 0):g} mm makes {count:,} samples of {1e3 * length:g} mm; "
            f"{1e3 * _round_up_to_nice(length / 1000):g} mm would work",
            where="--step",
        )
    return build_straight_line(start, end, count)


def _find_reached_box(arm: ReachingArm, options: MapOptions) -> dict[str, tuple[float, float]]:
    """Return the box of all places of a coarse grid that the TCP reaches in some rotation, rounded outwards."""
    centre, radius = compute_farthest_reach(arm.robot, arm.T_flange_tcp)
    T_frame_base = invert_transform(options.T_base_frame)
    middle = T_frame_base[:3, :3] @ centre + T_frame_base[:3, 3]
    coarse = tuple(
        SampleAxis(name, "m", np.linspace(-radius, radius, _PROBE[options.kind]) + middle[XYZ.index(name)])
        for name in options.axes
    )
    fixed = np.full(3, options.at)
    samples = build_position_grid(options.kind, coarse, fixed)
    gamma = options.gamma[0] + np.arange(_PROBE_ROTATIONS) * (2 * np.pi / _PROBE_ROTATIONS)
    gamma = gamma if len(options.gamma) > 1 else options.gamma
    if samples.position is None:
        raise ValueError("a grid of positions has positions")
    found = np.empty(len(samples), bool)
    for a in range(0, len(samples), 1024):
        poses = options.T_base_frame @ build_tool_poses(samples.position[a : a + 1024], options.tool_axis, gamma)
        reason = compute_candidates(arm, poses).reason
        found[a : a + 1024] = (reason == 0).reshape(len(poses), -1).any(axis=1)
    grid = found.reshape(samples.shape)
    out = {}
    for n, axis in enumerate(coarse):
        others = tuple(m for m in range(len(coarse)) if m != n)
        low, high = trim_axis(axis.values, np.asarray(grid.any(axis=others)))
        tidy = _round_up_to_nice((high - low) / 40)
        out[axis.name] = (float(np.floor(low / tidy) * tidy), float(np.ceil(high / tidy) * tidy))
    return out


def _choose_default_steps(spans: dict[str, tuple[float, float]], options: MapOptions) -> dict[str, float]:
    """One round step for all axes that have none."""
    steps = {name: options.steps.get(name, options.steps.get("")) for name in spans}
    if options.kind == "joints":
        most = CURVE_SAMPLES if len(spans) == 1 else DEFAULT_SAMPLES
    else:
        most = min(DEFAULT_SAMPLES, DEFAULT_POSES // (len(options.gamma) + 1))
    unit = radians(1.0) if options.kind == "joints" else 1e-3
    step = min(high - low for low, high in spans.values()) / most
    widest = max(high - low for low, high in spans.values())
    while step < widest and _count_samples(spans, {n: s or step for n, s in steps.items()}) > most:
        step *= 1.02
    return {n: s or _find_dividing_step(spans[n][1] - spans[n][0], step, unit) for n, s in steps.items()}


def _find_dividing_step(span: float, step: float, unit: float) -> float:
    """A step not below ``step`` that divides the span, in few digits where one within 40 % does."""
    count = max(int(span / step + 1e-9), 1)
    for digits in (1, 2, 3):
        for n in range(count, max(int(0.7 * count), 1) - 1, -1):
            if abs(float(f"{span / n / unit:.{digits}g}") * unit * n - span) < 1e-9 * span:
                return span / n
    return span / count


def _count_samples(spans: dict[str, tuple[float, float]], steps: dict[str, float]) -> float:
    """Return the number of samples as a float, because it may be very large."""
    return float(np.prod([np.floor((high - low) / steps[name] + 1e-9) + 1 for name, (low, high) in spans.items()]))


def _check_sample_count(
    spans: dict[str, tuple[float, float]], steps: dict[str, float], rotations: int, options: MapOptions
) -> None:
    count = _count_samples(spans, steps)
    most = min(MAX_SAMPLES, MAX_POSES // rotations)
    if count <= most:
        return
    unit = radians(1.0) if options.kind == "joints" else 1e-3
    scale = 1.0
    while _count_samples(spans, {n: _round_up_to_nice(s * scale / unit) * unit for n, s in steps.items()}) > most:
        scale *= 1.1
    better = {n: _round_up_to_nice(s * scale / unit) * unit for n, s in steps.items()}
    words = " ".join(f"--step {n}={_convert_to_user_unit(s, options):g}" for n, s in better.items())
    if len({f"{s:.9g}" for s in better.values()}) == 1:
        words = f"--step {_convert_to_user_unit(next(iter(better.values())), options):g}"
    times = f" × {rotations} rotations" if rotations > 1 else ""
    raise OptionError(
        f"{count:,.0f} samples{times} are too many; {words} would work ({_count_samples(spans, better):,.0f} samples)",
        where="--step",
    )


def _round_up_to_nice(value: float) -> float:
    """Return the next number not below ``value`` of NICE_STEPS × 10ⁿ."""
    power = 10.0 ** np.floor(np.log10(value) + 1e-12)
    return float(next((f * power for f in NICE_STEPS if f * power >= value * (1 - 1e-9)), 10.0 * power))


def _convert_to_user_unit(value: float, options: MapOptions) -> float:
    return round(degrees(value) if options.kind == "joints" else 1e3 * value, 6)


def _format_value(value: float, options: MapOptions) -> str:
    return f"{_convert_to_user_unit(value, options):g} {'deg' if options.kind == 'joints' else 'mm'}"
