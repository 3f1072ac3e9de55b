"""The document identification.json of an identification."""

from __future__ import annotations

from math import isfinite
from typing import Literal

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.documents.identification_document import (
    MISFIT_WARNING,
    IdentificationDocument,
    IdentifyOptionsSection,
    InseparableSumEntry,
    JointStiffnessEntry,
    MisfitSection,
    NoisePartsSection,
    OutlierReadingEntry,
    RangeShareSection,
    RecordingFindingEntry,
    StiffnessGridSection,
    TermCoefficientEntry,
)
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ModelDiscrepancy
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.identification.assessment.coefficient_uncertainty import compute_coefficient_uncertainty
from machopt.measurement.identification.assessment.misfit_intervals import (
    find_inseparable_sums,
    widen_stiffness_interval,
)
from machopt.measurement.identification.data_quality.unit_checks import describe_common_stiffness_factor
from machopt.measurement.identification.identification_result import IdentificationResult
from machopt.measurement.identification.request import IdentifyRequest
from machopt.numerics.array_types import Array
from machopt.version import __version__

CI90 = 0.9


def build_identification_document(
    request: IdentifyRequest,
    cell: Cell,
    recording: Recording,
    identification_result: IdentificationResult,
    inputs: dict[str, str],
) -> IdentificationDocument:
    """Build the document identification.json.

    Args:
        request: Validated user request.
        cell: Robot cell.
        recording: The recording.
        identification_result: Result of the identification.
        inputs: SHA-256 of the input files, by name.

    Returns:
        The document.
    """
    errors, unseen = identification_result.errors, identification_result.heldout
    joints90, terms90 = _compute_90_percent_intervals(identification_result)
    doubt = identification_result.stiffness.discrepancy
    if doubt is not None:
        joints90 = [
            widen_stiffness_interval(
                j.joint, j.k, ends, doubt, identification_result.sessions, identification_result.lever, CI90
            )
            if j.identified
            else ends
            for j, ends in zip(identification_result.joints, joints90, strict=True)
        ]
    result = IdentificationDocument(
        machopt_identification=1,
        version=__version__,
        cell=cell.name,
        recording=recording.source,
        model=identification_result.model,
        readings=identification_result.readings,
        poses=identification_result.poses,
        misfit=_build_misfit_section(request, doubt),
        joints=_build_joint_entries(identification_result, joints90),
        inseparable=_build_inseparable_entries(identification_result, load_robot(cell).axis),
        terms=_build_term_entries(identification_result, terms90),
        known_combinations=tuple(identification_result.combinations),
        rmse_mm=1e3 * errors.rmse,
        heldout_rmse_mm=None if unseen is None else 1e3 * unseen.rmse,
        rmse_mrad=1e3 * errors.rotation,
        heldout_rmse_mrad=None if unseen is None else 1e3 * unseen.rotation,
        explained_share=errors.explained,
        heldout_explained_share=None if unseen is None else unseen.explained,
        condition_number=identification_result.condition_number,
        condition_number_dumas2011=identification_result.condition_plain,
        interval_level=request.level_percent / 100.0,
        outliers=_build_outlier_entries(identification_result),
        noise_mm=_build_noise_entry(identification_result),
        findings=_build_finding_entries(identification_result),
        warnings=_list_warnings(cell, recording, identification_result),
        notes=(
            *identification_result.notes,
            *([identification_result.why_model] if identification_result.why_model else []),
        ),
        options=_build_options_section(request),
        inputs=inputs,
    )
    return result.model_copy(update=_build_optional_sections(identification_result))


def _build_finding_entries(result: IdentificationResult) -> tuple[RecordingFindingEntry, ...]:
    return tuple(
        RecordingFindingEntry(code=f.code, severity=f.severity, message=f.message, rows=tuple(r + 1 for r in f.rows))
        for f in result.findings
    )


def _build_inseparable_entries(result: IdentificationResult, axes: Array) -> tuple[InseparableSumEntry, ...]:
    """Return the sums of a joint and a body that the readings cannot separate; ``axes`` (6, 3) of the joints."""
    doubt = result.stiffness.discrepancy
    if doubt is None:
        return ()
    known = {j.joint: j.k for j in result.joints if j.identified}
    return tuple(
        InseparableSumEntry(
            joint=s.joint,
            body=s.body,
            sum_ci90_rad_per_Nm=s.compliance,
            joint_at_least_Nm_per_rad=s.least_joint_stiffness,
            body_at_most_rad_per_Nm=s.compliance[1],
        )
        for s in find_inseparable_sums(known, axes, doubt, result.sessions, CI90)
    )


def _list_warnings(cell: Cell, recording: Recording, result: IdentificationResult) -> tuple[str, ...]:
    """Return all warnings; those of a misfit come first."""
    return (
        *(w for w in result.warnings if w.startswith(MISFIT_WARNING)),
        *cell.warnings,
        *recording.warnings,
        *(w for w in result.warnings if not w.startswith(MISFIT_WARNING)),
        *_describe_common_factor(result, cell),
    )


def _build_options_section(request: IdentifyRequest) -> IdentifyOptionsSection:
    return IdentifyOptionsSection(
        model=request.model,
        fit=tuple(request.terms),
        geometric=request.geometric,
        plain_least_squares=request.plain,
        robust=request.robust,
        grid_cell_mm=request.grid_cell_mm,
        seed=request.seed,
    )


def _build_misfit_section(request: IdentifyRequest, doubt: ModelDiscrepancy | None) -> MisfitSection:
    """Return the misfit with the command that finds its cause."""
    if doubt is None:
        return MisfitSection(significant=False, noise_mm=None, left_mm=None, next="")
    paths = " ".join(str(p) for p in request.recordings)
    command = f"machopt diagnose {request.cell} {paths} -o OUT" if doubt.misfit else ""
    return MisfitSection(significant=doubt.misfit, noise_mm=1e3 * doubt.noise, left_mm=1e3 * doubt.left, next=command)


def _build_joint_entries(
    result: IdentificationResult, ninety: list[tuple[float, float]]
) -> tuple[JointStiffnessEntry, ...]:
    return tuple(
        JointStiffnessEntry(
            joint=j.joint,
            k_Nm_per_rad=j.k,
            ci90=ci90,
            identified=j.identified,
            reason=j.reason,
            largest_torque_Nm=j.torque,
            compliance_sigma_rad_per_Nm=j.sigma,
            interval=j.interval,
        )
        for j, ci90 in zip(result.joints, ninety, strict=True)
    )


def _build_term_entries(
    result: IdentificationResult, ninety: list[tuple[float, float]]
) -> tuple[TermCoefficientEntry, ...]:
    return tuple(
        TermCoefficientEntry(
            effect=t.effect,
            location=t.location,
            coefficient=t.name,
            unit=t.unit,
            value=t.value,
            ci90=ci90,
            identified=t.identified,
            reason=t.reason,
            interval=t.interval,
        )
        for t, ci90 in zip(result.terms, ninety, strict=True)
    )


def _build_outlier_entries(result: IdentificationResult) -> tuple[OutlierReadingEntry, ...]:
    return tuple(
        OutlierReadingEntry(
            reading=o.reading + 1,
            place=o.place,
            component=_COMPONENTS[o.axis],
            residual=1e3 * o.residual,
            unit="mm" if o.axis < 3 else "mrad",
            sigmas=o.sigmas,
        )
        for o in result.outliers
    )


_COMPONENTS: tuple[Literal["dx", "dy", "dz", "rx", "ry", "rz"], ...] = ("dx", "dy", "dz", "rx", "ry", "rz")


def _build_optional_sections(result: IdentificationResult) -> dict[str, object]:
    """Return the keys that exist only if they were computed."""
    out: dict[str, object] = {}
    if result.grid is not None:
        g = result.grid
        grid, constant = g.heldout.rmse
        out["grid"] = StiffnessGridSection(
            cell_mm=1e3 * g.grid.cell,
            origin_mm=tuple((1e3 * g.grid.origin).tolist()),
            shape=tuple(g.grid.shape),
            heldout_rmse_mm=1e3 * grid,
            heldout_rmse_constant_mm=1e3 * constant,
            spread_between_cells_percent=tuple((100 * g.spread).tolist()),
            held_joints=tuple(g.constant_joints),
            readings_per_cell=tuple(g.readings.tolist()),
        )
    if result.equilibrium_influence is not None:
        share = result.equilibrium_influence
        out["equilibrium_influence_share"] = RangeShareSection(mean=float(share.mean()), largest=float(share.max()))
    if result.monte_carlo is not None:
        out["monte_carlo_percent"] = tuple(_convert_to_finite(100 * v) for v in result.monte_carlo.spread)
    return out


def _build_noise_entry(result: IdentificationResult) -> NoisePartsSection:
    s = result.scatter[0]

    def mm(value: float | None) -> float | None:
        return None if value is None else 1e3 * value

    return NoisePartsSection(reading=mm(s.reading), cycle=mm(s.cycle), pose=mm(s.visit))


def _compute_90_percent_intervals(
    result: IdentificationResult,
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Return 90 % intervals of joints and of terms' coefficients, independent of the requested level."""
    if result.uncertainty.level == CI90:
        return [j.interval for j in result.joints], [t.interval for t in result.terms]
    sure = compute_coefficient_uncertainty(result.fit, CI90)
    joints = [
        (min(float(low), j.k), max(float(high), j.k)) if j.identified else (float(low), float(high))
        for j, (low, high) in zip(result.joints, sure.stiffness_interval(), strict=True)
    ]
    return joints, [(float(low), float(high)) for low, high in sure.interval[sure.joint_count :]]


def _convert_to_finite(value: float) -> float | None:
    return float(value) if isfinite(value) else None


def _describe_common_factor(result: IdentificationResult, cell: Cell) -> list[str]:
    """Describe a common ratio of all stiffnesses to the cell's, which indicates a wrong unit."""
    if cell.stiffness is None:
        return []
    known = [j for j in result.joints if j.identified]
    text = describe_common_stiffness_factor(
        np.array([j.k for j in known]), cell.stiffness.joints[[j.joint - 1 for j in known]]
    )
    return [text] if text else []
