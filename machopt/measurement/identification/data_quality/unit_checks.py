"""Unit checks by magnitude: displacement per load, rotation per translation, moment per force."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from machopt.effects.recording.record_faults import FORCES, LENGTHS
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.measurement.identification.data_quality.alternative_conventions import ConventionCandidate
from machopt.measurement.identification.data_quality.record_fault_type import RecordFault, format_row_locations
from machopt.numerics.array_types import Array

GENERIC_STIFFNESS, GENERIC_REACH = 1e6, 2.5  # typical joint stiffness N·m/rad at this reach (m); proportional to reach³
ROTATION_UNIT_FACTORS = {
    "rad": 1e-3,
    "degrees": float(np.degrees(1e-3)),
    "µrad": 1e3,
}  # recorded number per true number, for mrad


@dataclass(frozen=True)
class UnitSuspect:
    """Unit that columns may be in."""

    words: str  # "displacements in inches"
    column: str  # first column of the group
    factor: float  # correction factor for its values

    @property
    def ratio(self) -> float:
        """Ratio of recorded to true displacement per load."""
        return self.factor if self.column == FORCE else 1.0 / self.factor

    @property
    def thousands(self) -> bool:
        """Whether it is wrong by a factor of 1000, which is detectable for any robot."""
        return self.factor in (1e3, 1e-3)


DISPLACEMENT, FORCE = "dx_mm", "fx_N"
SUSPECTS = (
    *(UnitSuspect(f"displacements in {name}", DISPLACEMENT, mm) for name, mm in LENGTHS.items()),
    UnitSuspect("displacements in hundredths of a millimetre", DISPLACEMENT, 0.01),
    *(UnitSuspect(f"loads in {name}", FORCE, newtons) for name, newtons in FORCES.items()),
)


def _build_unit_fault(e: LoadTestExperiment, generic: float, seen: float, against: str) -> RecordFault:
    """Return the fault of wrong units, by the ratios to typical robots and to what was compared."""
    near = [u for u in _find_near_units(seen) if u in _find_near_units(generic)]
    if near and not any(u.thousands for u in near):
        cause = f"{' or '.join(u.words for u in near)} would make it so; mm and N would work"
        column, factor = near[0].column, near[0].factor
    else:
        cause, column, factor = _find_suspect_column(e, generic)
    message = f"displacement per load is {_format_ratio(seen)} {against}: {cause}"
    return RecordFault(code="units", severity="error", message=message, column=column, factor=factor)


def check_displacement_units(
    e: LoadTestExperiment, stated: ConventionCandidate, reach: float, prior: Array | None
) -> list[RecordFault]:
    """Check the displacement per load against the cell's stiffness and against robots of this size.

    Args:
        e: Load tests as stated.
        stated: Evaluation of the stated convention.
        reach: Reach of the arm, m.
        prior: (6,) joint stiffness of the cell, N·m/rad; None if unknown.

    Returns:
        The faults.
    """
    generic = _compute_typical_stiffness(reach, e.joint_count)
    s = _compute_displacement_ratio(e, generic, slice(0, 3))
    nominal = _compute_displacement_ratio(e, prior, slice(0, 3)) if prior is not None else np.nan
    if stated.unexplained > thresholds.SHARES.agreement or not s > 0:
        return []
    out = []
    if prior is None:
        wrong = _is_factor_off(s, thresholds.RATIOS.impossible)
        doubtful, against, seen = (
            _is_factor_off(s, thresholds.RATIOS.doubtful),
            "that of robots of this reach",
            s,
        )
    else:
        wrong = _is_factor_off(nominal, thresholds.RATIOS.impossible) and _is_factor_off(
            s, thresholds.RATIOS.implausible
        )
        doubtful, against, seen = (
            _is_factor_off(nominal, thresholds.RATIOS.doubtful),
            "what the cell's stiffness gives",
            nominal,
        )
    if wrong:
        out.append(_build_unit_fault(e, s, seen, against))
    elif doubtful:
        out.append(
            RecordFault(
                code="far_from_nominal",
                severity="warning",
                message=f"displacement per load is {_format_ratio(seen)} {against}{_format_suspects(seen)}; "
                f"check the units of load "
                f"and displacement{', or the stiffness in the cell' if prior is not None else ''}",
            )
        )
    turned = _compute_displacement_ratio(e, generic, slice(3, 6)) if e.dimensions == 6 else np.nan
    if turned > 0 and _is_factor_off(turned / s, thresholds.RATIOS.doubtful) and not wrong:
        out.append(_build_rotation_fault(turned / s, doubtful))
    return out


def check_moment_units(e: LoadTestExperiment, reach: float, prior: Array | None) -> list[RecordFault]:
    """Check for moments far beyond what the forces can cause on an arm of this size.

    Args:
        e: Load tests in base axes.
        reach: Reach of the arm, m.
        prior: (6,) joint stiffness of the cell, N·m/rad; None if unknown.

    Returns:
        The faults.
    """
    force, moment = np.linalg.norm(e.wrench[:, :3], axis=1), np.linalg.norm(e.wrench[:, 3:], axis=1)
    both = (force > 0) & (moment > thresholds.LIMITS.moment)
    if not both.any():
        return []
    lever: Array = np.where(both, moment / np.where(both, force, 1.0), 0.0)
    typical = float(np.median(lever[both]))
    if typical > thresholds.RATIOS.implausible * reach:
        cause, column, factor = _find_wrong_load_unit(e, reach, prior)
        return [
            RecordFault(
                code="moment_units",
                severity="error",
                message=f"moments are {typical:.3g} m times the forces, the arm reaches {reach:.2g} m: {cause}",
                column=column,
                factor=factor,
            )
        ]
    rows = np.flatnonzero(
        lever > max(thresholds.RATIOS.stiffness_error * reach, thresholds.RATIOS.implausible * typical)
    )
    if not len(rows):
        return []
    return [
        RecordFault(
            code="lever_arm",
            severity="warning",
            message=f"{format_row_locations(e, rows)}: the moment is more than {lever[rows].min():.2g} m times "
            f"the force, beyond the "
            f"arm's reach of {reach:.2g} m; check the moments there",
            rows=tuple(rows.tolist()),
        )
    ]


def estimate_reach(robot: Robot, T_flange_tcp: Array) -> float:
    """Estimate the reach of the arm from its second axis.

    Args:
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        Reach, m.
    """
    points = [*robot.point[1:], robot.T_base_flange_zero[:3, 3]]
    arm = sum(float(np.linalg.norm(b - a)) for a, b in pairwise(points))
    return arm + float(np.linalg.norm(T_flange_tcp[:3, 3]))


def _find_wrong_load_unit(e: LoadTestExperiment, reach: float, prior: Array | None) -> tuple[str, str, float]:
    """Find whether forces or moments are in another unit: the one whose correction gives typical displacements.

    Returns a description, the first column of the group, and the correction factor.
    """
    from dataclasses import replace

    as_kilonewtons, as_newton_millimetres = e.wrench.copy(), e.wrench.copy()
    as_kilonewtons[:, :3] *= 1e3
    as_newton_millimetres[:, 3:] *= 1e-3
    expected = _compute_typical_stiffness(reach, e.joint_count) if prior is None else prior
    off = [
        abs(np.log(_compute_displacement_ratio(replace(e, wrench=w), expected, slice(0, 3)) or np.nan))
        for w in (as_kilonewtons, as_newton_millimetres)
    ]
    if off[0] < off[1]:
        return "columns fx_N … seem to hold kilonewtons; newtons would work", "fx_N", 1e3
    return "columns mx_Nm … seem to hold N·mm; N·m would work", "mx_Nm", 1e-3


def _build_rotation_fault(ratio: float, displacement_doubtful: bool) -> RecordFault:
    """Return the fault of rotations that are inconsistent with the translations."""
    start = f"rotations are {_format_ratio(ratio)} what the translations of the same readings imply: "
    guess = min(ROTATION_UNIT_FACTORS, key=lambda unit: abs(np.log(ratio / ROTATION_UNIT_FACTORS[unit])))
    if _is_factor_off(ratio / ROTATION_UNIT_FACTORS[guess], thresholds.RATIOS.stiffness_error) or displacement_doubtful:
        return RecordFault(
            code="rotation_units",
            severity="error",
            message=start + "one of them is in another unit; mm and mrad would work",
            column="rx_mrad",
            factor=1.0 / ratio,
        )
    message = f"{start}columns rx_mrad … seem to hold {guess}; mrad would work"
    return RecordFault(
        code="rotation_units",
        severity="error",
        message=message,
        column="rx_mrad",
        factor=1.0 / ROTATION_UNIT_FACTORS[guess],
    )


def _compute_typical_stiffness(reach: float, joints: int) -> Array:
    return np.full(joints, GENERIC_STIFFNESS * (reach / GENERIC_REACH) ** 3)


def _compute_displacement_ratio(e: LoadTestExperiment, stiffness: Array, rows: slice) -> float:
    """Return the robust ratio of measured to predicted displacement; NaN if there is none."""
    predicted = e.response()[:, rows, : e.joint_count] @ (1.0 / stiffness)
    load = np.linalg.norm(e.wrench[:, :3], axis=1) + np.linalg.norm(e.wrench[:, 3:], axis=1)
    if not predicted.any() or not e.measured[:, rows].any():
        return float("nan")
    return float(fit_least_absolute_deviations(predicted[:, :, None], e.measured[:, rows], load)[0])


def describe_common_stiffness_factor(found: Array, prior: Array) -> str | None:
    """Describe a common ratio of all joints to the cell's stiffness that a wrong unit would cause.

    True stiffness differences vary between joints; a load in pounds changes all alike.

    Args:
        found: (n,) identified joint stiffnesses, N·m/rad.
        prior: (n,) stiffnesses of the cell, N·m/rad.

    Returns:
        A warning, or None.
    """
    if len(found) < thresholds.COUNTS.min_repetitions:
        return None
    logs = np.log(prior / found)
    ratio = float(np.exp(np.median(logs)))
    if float(np.abs(logs - np.median(logs)).max()) > np.log(thresholds.RATIOS.equal_fit):
        return None
    units = [u.words for u in SUSPECTS if abs(float(np.log(ratio / u.ratio))) < np.log(thresholds.RATIOS.equal_fit)]
    if not units:
        return None
    return (
        f"all {len(found)} identified joints have {_format_ratio(1.0 / ratio)} the cell's stiffness, as "
        f"{' or '.join(units)} "
        "would make it; check the units of load and displacement"
    )


def _is_factor_off(ratio: float, factor: float) -> bool:
    return not 1 / factor < ratio < factor


def _find_near_units(ratio: float) -> list[UnitSuspect]:
    """Return units that would cause the ratio, the closest first."""
    off = {u: abs(float(np.log(ratio / u.ratio))) for u in SUSPECTS}
    return [u for u in sorted(off, key=lambda u: off[u]) if off[u] < np.log(thresholds.RATIOS.double)]


def _format_suspects(ratio: float) -> str:
    near = [u.words for u in _find_near_units(ratio)]
    return f", as {' or '.join(near)} would make it" if near else ""


def _find_suspect_column(e: LoadTestExperiment, ratio: float) -> tuple[str, str, float]:
    """Return which column seems to be in another unit: description, first column of the group, correction factor."""
    force = float(np.median(np.linalg.norm(e.wrench[:, :3], axis=1)))
    moved = float(np.median(np.linalg.norm(e.measured[:, :3], axis=1)))
    if ratio < 1:
        return (
            f"with a median displacement of {1e3 * moved:.2g} mm under {force:.3g} N the columns dx_mm … seem to hold "
            "metres; millimetres would work",
            "dx_mm",
            1e3,
        )
    if force < thresholds.LIMITS.force:
        words = f"with a median force of {force:.2g} N the columns fx_N … seem to hold kilonewtons; newtons would work"
        return words, "fx_N", 1e3
    return (
        f"with a median displacement of {1e3 * moved:.3g} mm under {force:.3g} N the columns dx_mm … seem to hold "
        "micrometres (or fx_N … a thousandth of newtons); millimetres would work",
        "dx_mm",
        1e-3,
    )


def _format_ratio(ratio: float) -> str:
    return f"{ratio:.3g} times" if ratio >= 1 else f"1/{1 / ratio:.3g} of"
