"""Effects that twist a joint by its torque in static readings: each registered law, transformed to the TCP.

τ is the torque that a law depends on: the total torque including gravity for nonlinear elastic laws, the load torque
for others. A load-test reading contains φ(loaded) − φ(unloaded), a measured pose contains φ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from machopt.data_types.effect_locations import format_joint_location, parse_joint_location
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects import parameter_conversion, registry
from machopt.effects.joint.angle_dependent_stiffness import AngleDependentCompliance
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import ARCMIN, MEMORIES, Effect, JointLaw, JointLoading, JointLoadRange, is_time_dependent
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, LawCurve, Quantity, Shape
from machopt.measurement.diagnosis.data_types.gear_load_history import build_load_history
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.model_selection.search.shape_refinement import build_two_number_refinement
from machopt.numerics.array_types import Array

LEAST_SOFT = 1e-9  # rad/(N·m), lower limit of the compliance that percentages refer to
WRIST = 3  # first wrist joint, 0-based
CYCLE_MEMORIES = ("cycle", "approach")  # reset at each cycle; not applicable to time-dependent laws
FINE = 60  # points of a loop's branch in the figure; sampled angles of a range


def build_joint_hypotheses(r: StaticReadings, j: int, effect: Effect) -> tuple[list[EffectHypothesis], str]:
    """Build the hypotheses of an effect at one joint.

    Args:
        r: Static readings.
        j: Joint index, 0-based.
        effect: Effect with joint laws.

    Returns:
        The hypotheses, and the reason if the readings cannot show any.
    """
    out, reasons = [], []
    for law in effect.joint_laws:
        if is_time_dependent(law) and r.recording.time is None:
            reasons.append("the recording has no time_s")
            continue
        scale = compute_joint_load_range(r, j, law)
        reason = law.explain_undetectable(
            r.torque[:, j], r.weight_torque[:, j] if r.is_difference else np.zeros(len(r)), scale
        )
        if reason and r.is_difference:
            reasons.append(reason)
            continue
        grid = law.grid(scale)
        if grid:
            out.append(_build_joint_hypothesis(r, j, effect, law, scale, grid))
    return out, "" if out or not reasons else reasons[0]


def compute_joint_load_range(r: StaticReadings, j: int, law: JointLaw) -> JointLoadRange:
    """Compute the load and angle range of a joint that shares and sizes of a law refer to.

    Args:
        r: Static readings.
        j: Joint index, 0-based.
        law: Joint law.

    Returns:
        The range.
    """
    rare = thresholds.SHARES.negligible
    low, high = np.quantile(r.state.q[:, j], (rare, 1.0 - rare))
    torque = r.torque[:, j] if law.includes_weight or not r.is_difference else r.load_torque[:, j]
    # an angle-dependent law may take all of the spring: its share refers to the spring fitted alone
    soft = (
        r.springs_only_compliance
        if r.springs_only_compliance is not None and isinstance(law, AngleDependentCompliance)
        else r.compliance
    )
    return JointLoadRange(
        max_torque=_compute_largest_torque(torque),
        compliance=max(float(soft[j]), LEAST_SOFT),
        min_angle=float(low),
        max_angle=float(high),
    )


def _build_joint_hypothesis(
    r: StaticReadings, j: int, effect: Effect, law: JointLaw, scale: JointLoadRange, grid: tuple[Shape, ...]
) -> EffectHypothesis:
    where = format_joint_location(j + 1)
    own = len(law.shape) and len(
        grid[0]
    )  # number of shape parameters; the index of the load history in MEMORIES follows

    def memory(shape: Shape) -> str:
        return MEMORIES[int(shape[own])] if law.has_memory else ""

    def columns(shape: Shape) -> Array:
        return r.lift_joint_twist(j, compute_joint_twist(r, j, law, np.array(shape[:own]), memory(shape)))

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape[:own]), scale)

    def term(x: Array, shape: Shape) -> StiffnessTerm:
        return StiffnessTerm(
            effect.name, where, parameter_conversion.write_law_parameters(law, x, np.array(shape[:own]), memory(shape))
        )

    def curve(x: Array, shape: Shape) -> LawCurve:
        at = np.array(shape[:own])
        return (
            _build_hysteresis_curve(r, j, law, at, x, memory(shape), scale)
            if law.has_memory
            else _build_memoryless_curve(r, j, law, at, x)
        )

    def buildable(x: Array, shape: Shape) -> bool:
        return not (r.is_difference and isinstance(law, AngleDependentCompliance)) or _is_compliance_plausible(
            law, x, np.array(shape[:own]), scale
        )

    if law.has_memory:
        grid = tuple((*s, float(k)) for k in _list_memories(r, law) for s in grid)
    count = columns(grid[0]).shape[2]
    lower = tuple(least for _, _, least in parameter_conversion.list_coefficient_names(law, count))
    return EffectHypothesis(
        effect=effect.name,
        location=where,
        law=law.name,
        equation=law.equation,
        columns=columns,
        quantities=sizes,
        shapes=grid,
        lower=lower if np.isfinite(lower).any() else (),
        correction=term,
        note=effect.note,
        family="joint",
        is_plausible=buildable,
        refinement=None if law.has_memory else build_two_number_refinement(grid),
        curve=curve if law.includes_weight or (law.has_memory and not is_time_dependent(law)) else None,
    )


def _list_memories(r: StaticReadings, law: JointLaw) -> list[int]:
    """Return the indices in MEMORIES of the load histories that the readings can tell apart."""
    once = len(r.cycles) == len(np.unique(r.visit))  # every cycle is an arrival
    return [
        k
        for k, m in enumerate(MEMORIES)
        if not (is_time_dependent(law) and m in CYCLE_MEMORIES) and not (once and m == CYCLE_MEMORIES[1])
    ]


def _is_compliance_plausible(law: AngleDependentCompliance, x: Array, shape: Array, scale: JointLoadRange) -> bool:
    """Return whether an angle-dependent compliance is positive over the range and does not vary implausibly.

    At a joint with almost no compliance a law may vary by any percentage of it.
    """
    share = law.shares(shape, np.linspace(scale.min_angle, scale.max_angle, FINE)) @ x
    at = share - share.mean() + (scale.compliance or 0.0)  # relative to the joint's mean compliance
    return bool(at.max() <= thresholds.RATIOS.doubtful * at.min())


def build_joint_pair_hypothesis(
    r: StaticReadings, effect: Effect, where: str, note: str, equation: str = ""
) -> EffectHypothesis:
    """Build the hypothesis of a coupling of two joints, each twisted by the torque of the other.

    Args:
        r: Static readings.
        effect: Effect between two joints.
        where: Location of both joints.
        note: Where the effect is visible.
        equation: Equation; empty uses that of the law.

    Returns:
        The hypothesis.
    """
    law, (i, j) = effect.joint_laws[0], parse_joint_location(where)
    tau = r.load_torque if r.is_difference else r.torque
    scale = JointLoadRange(max_torque=_compute_largest_torque(tau[:, [i, j]]))

    def columns(shape: Shape) -> Array:
        by_j, by_i = (law.columns(np.array(shape), JointLoading(tau[:, k])) for k in (j, i))
        return r.lift_joint_twist(i, by_j) + r.lift_joint_twist(j, by_i)

    return EffectHypothesis(
        effect=effect.file_word,
        location=where,
        law=law.name,
        equation=equation or law.equation,
        columns=columns,
        quantities=lambda x, s: law.sizes(x, np.array(s), scale),
        shapes=law.grid(scale),
        correction=lambda x, s: StiffnessTerm(
            effect.file_word, where, parameter_conversion.write_law_parameters(law, x, np.array(s))
        ),
        family="joint",
        note=note,
    )


def build_load_test_couplings(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the elastic couplings of joints for load tests.

    Args:
        r: Static readings.

    Returns:
        The hypotheses.
    """
    note, equation = (
        "out of what the joints' torques explain",
        "Δq_i = c_ij τ_j, Δq_j = c_ij τ_i (wrist gears on one shaft)",
    )
    return [
        build_joint_pair_hypothesis(r, e, where, note, equation)
        for e in registry.select_joint_pair_effects()
        for where in r.list_places(e.search_places)
    ]


def build_pose_couplings(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the elastic couplings of the wrist joints for measured poses, where weight or load twists either joint.

    Args:
        r: Static readings.

    Returns:
        The hypotheses.
    """
    return [
        build_joint_pair_hypothesis(
            r, e, where, "with the torque of the other joint", f"{e.joint_laws[0].equation} under weight and load"
        )
        for e in registry.select_joint_pair_effects()
        for where in r.list_places(e.search_places)
        if min(parse_joint_location(where)) >= WRIST and np.abs(r.torque[:, parse_joint_location(where)]).max() > 0.0
    ]


def compute_memory_term_displacement(
    r: StaticReadings, terms: Sequence[StiffnessTerm]
) -> tuple[Array, tuple[StiffnessTerm, ...]]:
    """Compute the displacement of a load test by terms with a stated load history.

    Args:
        r: Static readings.
        terms: Terms; those without ``memory`` are ignored, and time-dependent ones if no time is recorded.

    Returns:
        (N, 6) displacement at the TCP, m and rad, and the terms that are not included.
    """
    moved, others = np.zeros((len(r), 6)), []
    single = {e.file_word: e for e in registry.select_joint_torque_effects()}
    for term in terms:
        effect = single.get(term.effect)
        if effect is None or "memory" not in term.parameters:
            others.append(term)
            continue
        given = ParameterReader(term.parameters, term.effect)
        law = parameter_conversion.find_law(effect, given)
        values, shape, memory = parameter_conversion.read_law_parameters(law, given)
        if is_time_dependent(law) and r.recording.time is None:
            others.append(term)
            continue
        j, _ = parse_joint_location(term.location)
        moved += r.state.J[:, :, j] * (compute_joint_twist(r, j, law, shape, memory) @ values)[:, None]
    return moved, tuple(others)


def compute_joint_term_displacement(r: StaticReadings, term: StiffnessTerm) -> Array:
    """Compute the displacement of measured poses by a term of one joint or of a pair.

    The load history is that of
    :func:`machopt.measurement.diagnosis.effect_columns.existing_terms.compute_known_pose_displacement`.

    Args:
        r: Static readings.
        term: Term of a stiffness model.

    Returns:
        (N, D) m, rad.
    """
    effect = registry.find_elastic_effect(term.effect)
    given = ParameterReader(term.parameters, term.effect)
    law = parameter_conversion.find_law(effect, given)
    values, shape, _ = parameter_conversion.read_law_parameters(law, given)
    i, j = parse_joint_location(term.location)
    by_j, by_i = (law.columns(shape, JointLoading(r.torque[:, k], r.state.q[:, k])) @ values for k in (j, i))
    own, other = (r.project_to_measured(r.state.J[:, :, k] * by[:, None], k + 1) for k, by in ((i, by_j), (j, by_i)))
    return np.asarray(own + (other if effect.is_joint_pair else 0.0))


def compute_joint_twist(r: StaticReadings, j: int, law: JointLaw, shape: Array, memory: str) -> Array:
    """Compute the twist of a joint per unit of each coefficient, as the readings contain it.

    Args:
        r: Static readings.
        j: Joint index, 0-based.
        law: Joint law.
        shape: (S,) shape parameters, SI.
        memory: Kind of load history.

    Returns:
        (N, P) rad.
    """
    angle = r.state.q[:, j]
    if law.has_memory:
        states = build_load_history(r, memory)
        return states.compute_reading_values(law.columns(shape, states.select_joint(j, angle)), r.is_difference)
    if not r.is_difference:
        return law.columns(shape, JointLoading(r.torque[:, j], angle))
    if not law.includes_weight:
        return law.columns(shape, JointLoading(r.load_torque[:, j], angle))
    with_load, without = (
        law.columns(shape, JointLoading(tau, angle)) for tau in (r.torque[:, j], r.weight_torque[:, j])
    )
    return np.asarray(with_load - without)


def _build_memoryless_curve(r: StaticReadings, j: int, law: JointLaw, shape: Array, x: Array) -> LawCurve:
    """Return the curve of a law without memory over the torque."""
    tau = r.torque[:, j]
    span = float(np.abs(tau).max())
    at = np.linspace(-span, span, 2 * FINE + 1)
    line, each = (law.columns(shape, JointLoading(t, np.zeros_like(t))) @ x / ARCMIN for t in (at, tau))
    return LawCurve(
        x=at,
        law=line,
        x_label=f"torque at joint {j + 1} in N·m, weight included",
        y_label="twist in arcmin",
        data_x=tau,
        per_reading=each,
    )


def _build_hysteresis_curve(
    r: StaticReadings, j: int, law: JointLaw, shape: Array, x: Array, memory: str, scale: JointLoadRange
) -> LawCurve:
    """Return the curve of a law with memory over one load cycle up to the largest torque and back."""
    up = np.linspace(0.0, scale.max_torque, FINE)
    path = np.concatenate([up, up[::-1]])
    first = np.zeros(len(path), np.int64)
    first[0] = 1
    cycle = law.columns(shape, JointLoading(path, np.zeros_like(path), None, first)) @ x
    each = compute_joint_twist(r, j, law, shape, memory) @ x
    return LawCurve(
        x=path,
        law=cycle / ARCMIN,
        x_label=f"load torque at joint {j + 1} in N·m",
        y_label="twist in arcmin",
        data_x=r.load_torque[:, j],
        per_reading=each / ARCMIN,
    )


def _compute_largest_torque(tau: Array) -> float:
    return max(float(np.quantile(np.abs(tau), 1.0 - thresholds.SHARES.negligible)), float(np.finfo(float).tiny))
