"""Torque in parallel to a gear as a function of the joint angle (gravity compensator), in each channel.

In measured poses the torque deflects the joint. A load test shows the stiffness of the spring in parallel to the
gear, and the changed lever arms. The motor torque contains it directly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from machopt.data_types.effect_locations import parse_joint_location, parse_location
from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects import measured_angle_range, parameter_conversion, registry
from machopt.effects.joint import joint_angle_errors
from machopt.effects.joint.gravity_compensator import LINKAGE, convert_to_file_law
from machopt.effects.kinematic_corrections import build_kinematic_correction
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import Effect, ParallelTorqueLaw
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    EffectHypothesis,
    LawCurve,
    Quantity,
    RecordCorrection,
    Shape,
    ShapeRefinement,
)
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns.motion_columns import (
    MotionModel,
    build_binned_curve,
    build_joint_law_hypothesis,
)
from machopt.measurement.estimation.reading_covariance import compute_joint_sensitivity
from machopt.numerics.array_types import Array

SUBSCRIPTS = "₁₂₃₄₅₆"
ARM = 6  # number of joints in stiffness.yaml
FINE = 90  # points of a curve over the joint's range
RATIO, ANGLE = 1.5, np.radians(30.0)  # grid spacing of the lever ratio (factor) and of the angle
EQUIVALENT_ORDERS = (1.0, 2.0, 3.0)  # waves per turn that state the rotation by a compensator
EQUIVALENT_RCOND = 1e-8  # waves of nearly equal form over a short range get no opposite amplitudes
REFINEMENT_POINTS = 7  # refinement points of each parameter


def build_pose_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the hypotheses for measured poses: the torque deflects the joint.

    Args:
        r: Static readings.

    Returns:
        The hypotheses; none if masses are unknown.
    """
    if r.masses is None:
        return []
    return [
        _build_deflection_hypothesis(r, effect, where, law)
        for effect, where in _list_places()
        if _has_turning_joint(r, where)
        for law in effect.parallel_torque_laws
    ]


def build_load_test_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the hypotheses for load tests: a spring in parallel to the gear, by the law that files state.

    Args:
        r: Static readings.

    Returns:
        The hypotheses.
    """
    return [
        _build_stiffness_hypothesis(r, effect, where, effect.parallel_torque_laws[0])
        for effect, where in _list_places()
        if _has_turning_joint(r, where)
    ]


def build_torque_hypotheses(scene: MotionModel) -> list[EffectHypothesis]:
    """Build the hypotheses for motor torques, the law with the fewest parameters first.

    Args:
        scene: Motion model.

    Returns:
        The hypotheses.
    """
    return [
        _build_torque_hypothesis(scene, effect, where, law)
        for effect, where in _list_places()
        if _is_joint_moving(scene, parse_joint_location(where)[0])
        for law in sorted(effect.parallel_torque_laws, key=lambda law: len(law.shape))
    ]


def compute_known_torque(terms: Sequence[StiffnessTerm], q: Array) -> Array:
    """Compute the joint torques of the cell's own compensators. Motors and gears carry less by this amount.

    Args:
        terms: Terms of the cell's stiffness.
        q: (M, n) joint angles, rad.

    Returns:
        (M, n) N·m.
    """
    out = np.zeros_like(q)
    for term in terms:
        effect = registry.find_elastic_effect(term.effect)
        if effect.parallel_torque_laws and (j := parse_joint_location(term.location)[0]) < q.shape[1]:
            law = effect.parallel_torque_laws[0]
            values, shape, _ = parameter_conversion.read_law_parameters(
                law, ParameterReader(term.parameters, term.effect)
            )
            out[:, j] += law.torque(shape, q[:, j]) @ values
    return out


def compute_angle_only_torques(q: Array) -> Array:
    """Compute the columns of laws without shape parameters at their joints.

    Args:
        q: (M, n) joint angles, rad.

    Returns:
        (M, n, p) N·m per unit of each coefficient.
    """
    parts = [
        (j, law.torque(np.zeros(0), q[:, j]))
        for effect, where in _list_places()
        if (j := parse_joint_location(where)[0]) < q.shape[1]
        for law in effect.parallel_torque_laws
        if not law.shape
    ]
    out = np.zeros((*q.shape, sum(x.shape[1] for _, x in parts)))
    at = 0
    for j, x in parts:
        out[:, j, at : at + x.shape[1]] = x
        at += x.shape[1]
    return out


def _list_places() -> list[tuple[Effect, str]]:
    return [(e, where) for e in registry.select_parallel_torque_effects() for where in e.places]


def _has_turning_joint(r: StaticReadings, where: str) -> bool:
    j = parse_joint_location(where)[0]
    return bool(r.compliance[j] > 0.0 and np.ptp(r.state.q[:, j]) >= thresholds.LIMITS.joint_range)


def _is_joint_moving(scene: MotionModel, j: int) -> bool:
    return j < scene.joints and scene.is_joint_moving(j) and not scene.prismatic[j]


def _build_note(where: str) -> str:
    return f"joint {parse_location(where).which} only, by its angle"


def _build_deflection_hypothesis(
    r: StaticReadings, effect: Effect, where: str, law: ParallelTorqueLaw
) -> EffectHypothesis:
    j = parse_joint_location(where)[0]
    q, c, sub = r.state.q[:, j], float(r.compliance[j]), SUBSCRIPTS[j]
    along = np.linspace(q.min(), q.max(), FINE)

    def torque(at: Array, shape: Shape) -> Array:
        return law.torque(np.array(shape), at)

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return {"peak_torque": Quantity(float(np.abs(torque(along, shape) @ x).max()), "N·m")}

    def line(x: Array, shape: Shape) -> LawCurve:
        return LawCurve(
            x=np.degrees(along),
            law=torque(along, shape) @ x,
            x_label=f"joint {j + 1} in deg",
            y_label="torque in N·m",
            data_x=np.degrees(q),
            per_reading=torque(q, shape) @ x,
        )

    return EffectHypothesis(
        effect=effect.file_word,
        location=where,
        law=law.name,
        equation=f"Δ{sub} = c{sub} τ, {law.equation}",
        columns=lambda shape: r.lift_joint_twist(j, c * torque(q, shape)),
        quantities=sizes,
        shapes=law.grid(),
        correction=lambda x, s: build_equivalent_waves(where, q, c * torque(q, s) @ x),
        family="joint",
        note=_build_note(where),
        penalty=law.penalty,
        curve=line,
        refinement=ShapeRefinement(shapes_around=_refine_spring_shapes) if law is LINKAGE else None,
    )


def build_equivalent_waves(where: str, q: Array, turned: Array) -> KinematicCorrection:
    """Build the entry of kinematics.yaml for a rotation that depends on the joint's own angle alone.

    Poses at rest do not tell a torque of the angle from an error of the encoder. The file states the rotation as a sum
    of waves over the measured angles, which needs no stiffness of the gear.

    Args:
        where: Location, for example ``joint:2``.
        q: (N,) encoder angles of the joint, rad.
        turned: (N,) rotation at these angles, rad.

    Returns:
        The entry.
    """
    law = joint_angle_errors.WAVES.angle_laws[0]
    shape = np.array(EQUIVALENT_ORDERS)
    values = np.asarray(np.linalg.lstsq(law.columns(shape, q), turned, rcond=EQUIVALENT_RCOND)[0], float)
    over = {measured_angle_range.RANGE_KEY: measured_angle_range.compute_measured_range(q)}
    return build_kinematic_correction(joint_angle_errors.WAVES, where, values, shape, over)


def _refine_spring_shapes(shape: Shape, share: float) -> tuple[Shape, ...]:
    """Return spring shapes around a given one, up to a share of the distance to its grid neighbours."""
    steps = (share * np.linspace(-1.0, 1.0, REFINEMENT_POINTS)).tolist()
    return tuple((shape[0] * RATIO**a, shape[1] + ANGLE * b) for a in steps for b in steps)


def _build_stiffness_hypothesis(
    r: StaticReadings, effect: Effect, where: str, law: ParallelTorqueLaw
) -> EffectHypothesis:
    j = parse_joint_location(where)[0]
    q, tau, c, sub = r.state.q[:, j], r.load_torque[:, j], r.compliance[j], SUBSCRIPTS[j]
    # the spring also deflects the unloaded arm and thus changes all lever arms of the load
    moved = compute_joint_sensitivity(r.state.J, r.wrench, r.compliance)[:, : r.dimensions, j]

    def columns(shape: Shape) -> Array:
        torque, slope = (of(np.array(shape), q) for of in (law.torque, law.slope))
        return np.asarray(
            r.lift_joint_twist(j, c**2 * tau[:, None] * slope) + moved[:, :, None] * (c * torque)[:, None, :]
        )

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        slope = law.slope(np.array(shape), np.linspace(q.min(), q.max(), 60))
        peak = float(np.abs(law.torque(np.array(shape), along) @ x).max())
        varies = Quantity(50.0 * float(np.ptp(slope @ x)) * c, "%")
        return {"variation": varies, "peak_torque": Quantity(peak, "N·m"), **law.sizes(x)}

    along = np.linspace(q.min(), q.max(), FINE)
    weight = float(np.abs(r.weight_torque[:, j]).max())

    def buildable(x: Array, shape: Shape) -> bool:
        """A balancer is there for the weight."""
        peak = float(np.abs(law.torque(np.array(shape), along) @ x).max())
        return peak <= thresholds.RATIOS.impossible * weight

    return EffectHypothesis(
        effect=effect.file_word,
        location=where,
        law=law.name,
        equation=f"k{sub}(q{sub}) = k{sub} − ∂τ/∂q{sub}, {law.equation}",
        columns=columns,
        quantities=sizes,
        shapes=law.grid(),
        correction=lambda x, s: StiffnessTerm(
            effect.file_word, where, parameter_conversion.write_law_parameters(law, x, np.array(s))
        ),
        family="joint",
        note=_build_note(where),
        penalty=law.penalty,
        is_plausible=buildable,
    )


def _build_torque_hypothesis(
    scene: MotionModel, effect: Effect, where: str, law: ParallelTorqueLaw
) -> EffectHypothesis:
    j = parse_joint_location(where)[0]
    q = scene.motion.q[:, j]
    planned = scene.joints == ARM and not any(scene.prismatic)  # otherwise stiffness.yaml cannot state it

    def signal(s: Shape) -> Array:
        return law.torque(np.array(s), q)

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        pull = signal(s) @ x
        # the joint's offset absorbs a constant part: only the variation is observable
        return {
            "variation": Quantity(float(np.ptp(pull)), "N·m"),
            "peak_torque": Quantity(float(np.abs(pull).max()), "N·m"),
        }

    def stated(x: Array, s: Shape) -> StiffnessTerm | RecordCorrection:
        # the torque acts on the joint and reduces the motor torque
        parameters = parameter_conversion.write_law_parameters(
            effect.parallel_torque_laws[0], *convert_to_file_law(law, -x, np.array(s))
        )
        return (StiffnessTerm if planned else RecordCorrection)(effect.file_word, where, parameters)

    return build_joint_law_hypothesis(
        scene,
        j,
        effect.file_word,
        law.name,
        f"τ{SUBSCRIPTS[j]} −= τ, {law.equation}",
        signal,
        sizes,
        law.grid(),
        family="compensator",
        curve=lambda x, s: build_binned_curve(
            scene, np.degrees(q), signal(s) @ x, f"joint {j + 1} in degrees", "torque in N·m"
        ),
        note=f"with the angle of joint {j + 1}",
        correction=stated,
    )
