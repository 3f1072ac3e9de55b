"""Mean-force regression: the six milling coefficients with their covariance.

Mean forces are linear in the coefficients, and each coefficient's column follows from the force model with that
coefficient alone. Travel, normal and axial force scatter differently; each has its own variance, estimated from its
residuals (feasible generalised least squares). Intervals use Student's t with the fewest degrees of freedom among the
components that tell a coefficient.

Source: Altıntaş, Manufacturing Automation, 2nd ed. (2012), section 2.8.1; Budak, Altıntaş & Armarego, J. Eng. Ind. 118
(1996) 216.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.data_types.measurements.cutting_recording import CuttingRecording
from machopt.errors import CuttingInputError, RecordingError
from machopt.numerics.array_types import Array, Bools, make_arrays_read_only
from machopt.process.milling.mean_force import compute_mean_load
from machopt.process.milling.milling_cut import CutSide, MillingCut, MillingCutter, check_cutter

NAMES = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")
UNITS = (1e6, 1e6, 1e6, 1e3, 1e3, 1e3)  # Pa per N/mm², N/m per N/mm
COMPONENTS = ("travel", "normal", "axial")
FEWEST_ROWS = 4  # with two unknowns a component, two degrees of freedom are left
RANK = 1e-7  # of the scaled design: a smaller singular value is rounding of the forces' seven digits
OUTLIER_LEVEL = 0.01  # chance that a recording without outliers loses a row, over all rows together (Bonferroni)
MOST_OUTLIERS = 0.2  # share of rows; more are no outliers
REWEIGHTINGS = 30


@dataclass(frozen=True, kw_only=True)
class CoefficientFit:
    """Result of a regression; values in N/mm² and N/mm, in the order of ``NAMES``."""

    values: Array  # (6,)
    covariance: Array  # (6, 6)
    low: Array  # (6,) interval
    high: Array  # (6,)
    level: float  # of the interval, 0 … 1
    fixed: tuple[str, ...]  # coefficients that were set to 0
    measured: Array  # (N, 3) N
    predicted: Array  # (N, 3) N
    feed_per_tooth: Array  # (N,) m
    used: Bools  # (N,)
    reasons: tuple[str, ...]  # (N,) why a row is not used; empty where it is
    residual: Array  # (3,) N, 1 sigma of each component
    explained: Array  # (3,) R² of each component about its mean
    sigma_log: float  # relative uncertainty of the predicted resultant, with the misfit, as a logarithm
    warnings: tuple[str, ...]

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


@dataclass(frozen=True)
class _Solution:
    values: Array  # (k,)
    covariance: Array  # (k, k)
    variance: Array  # (3,)
    freedom: Array  # (3,) of each component
    leverage: Array  # (n, 3)


def fit_coefficients(
    recording: CuttingRecording, cutter: MillingCutter, force: Array, *, level: float = 0.9, keep_outliers: bool = False
) -> CoefficientFit:
    """Return the coefficients that explain the measured mean forces.

    Args:
        recording: measured cuts.
        cutter: end mill of the cuts.
        force: (N, 3) N, travel, normal, axial, on the tool.
        level: of the intervals, 0 … 1.
        keep_outliers: no row is left out because of its residual.

    Raises:
        RecordingError: too few rows, feeds that cannot separate cutting and edge coefficients, or forces of another
            sign or frame.
        CuttingInputError: an impossible cutter.
    """
    check_cutter(cutter)
    fz = recording.feed / (recording.spindle_speed * cutter.teeth)
    design, reasons = _build_design(recording, cutter, fz)
    free = np.ones(6, bool)
    warnings: list[str] = []
    while True:
        used = np.array([not reason for reason in reasons])
        _check_rows(recording, used, fz)
        solution = _solve(design[used][..., free], force[used])
        outlier = None if keep_outliers else _find_outlier(design[used][..., free], force[used], solution)
        if (
            outlier is not None
            and np.sum(used) - 1 >= FEWEST_ROWS
            and _count_outliers(reasons) < MOST_OUTLIERS * len(fz)
        ):
            row, text = outlier
            reasons[int(np.flatnonzero(used)[row])] = text
            continue
        low, high = _compute_intervals(solution, design[used][..., free], level)
        negative = _find_negative_coefficient(solution.values, high, free)
        if negative is None:
            break
        free[negative] = False
        warnings.append(f"{NAMES[negative]} came out negative within its interval and is set to 0")
    equations = _ForceEquations(design=design, force=force, feed_per_tooth=fz, free=free, reasons=reasons)
    warnings += _list_fit_warnings(equations, (low, high), level)
    return _build_fit(equations, solution, (low, high), level, (*recording.warnings, *warnings))


def _build_design(recording: CuttingRecording, cutter: MillingCutter, fz: Array) -> tuple[Array, list[str]]:
    """Return (N, 3, 6) force per N/mm² and N/mm, and why a row cannot be used."""
    design = np.zeros((len(recording), 3, 6))
    reasons = [""] * len(recording)
    for row in range(len(recording)):
        side: CutSide = recording.side[row]  # type: ignore[assignment]
        cut = MillingCut(side, recording.spindle)
        ae = cutter.diameter if side == "slot" and np.isnan(recording.ae[row]) else recording.ae[row]
        try:
            for k in range(6):
                load = compute_mean_load(_build_unit_set(k), cutter, cut, ae, recording.ap[row])
                design[row, :, k] = load.compute_load(fz[row])[0, :3]
        except CuttingInputError as problem:
            if problem.key == "helix_deg":
                raise
            reasons[row] = problem.reason
            continue
        if not design[row].any():
            reasons[row] = "nothing is cut: ae or ap is 0"
    return design, reasons


def _build_unit_set(k: int) -> MillingCoefficients:
    values = [UNITS[n] if n == k else 0.0 for n in range(6)]
    return build_milling_coefficients(np.array(values) / UNITS, (0.0, 1.0), 0.0, "")


def build_milling_coefficients(
    values: Array, h_range_m: tuple[float, float], sigma_log: float, source: str
) -> MillingCoefficients:
    """Return coefficients in SI units.

    Args:
        values: (6,) N/mm² and N/mm, in the order of ``NAMES``.
        h_range_m: m, range of chip thickness.
        sigma_log: standard deviation of the logarithm.
        source: where they come from.
    """
    si = [float(v) for v in np.asarray(values) * UNITS]
    return MillingCoefficients(
        Ktc_Pa=si[0],
        Krc_Pa=si[1],
        Kac_Pa=si[2],
        Kte_N_m=si[3],
        Kre_N_m=si[4],
        Kae_N_m=si[5],
        h_range_m=h_range_m,
        sigma_log=sigma_log,
        source=source,
    )


def _check_rows(recording: CuttingRecording, used: Bools, fz: Array) -> None:
    count = int(np.sum(used))
    if count < FEWEST_ROWS:
        raise RecordingError(
            f"{count} of {len(used)} cuts can be used; {FEWEST_ROWS} or more are needed, at three feeds or more",
            file=recording.files[0],
        )
    if fz[used].max() < 1.2 * fz[used].min():
        raise RecordingError(
            f"the feeds per tooth lie between {fz[used].min() * 1e3:.4g} and {fz[used].max() * 1e3:.4g} mm: too close "
            "to separate cutting and edge coefficients; feeds that differ by a factor of two or more would work",
            file=recording.files[0],
        )


def _solve(design: Array, force: Array) -> _Solution:
    """Solve with a variance for each component, estimated from its residuals."""
    rows, _, k = design.shape
    variance = np.ones(3)
    for step in range(REWEIGHTINGS):
        A = (design / np.sqrt(variance)[:, None]).reshape(-1, k)
        y = (force / np.sqrt(variance)).reshape(-1)
        scale = np.linalg.norm(A, axis=0)
        U, s, Vt = np.linalg.svd(A / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
        if (scale == 0.0).any() or s[-1] < RANK * s[0]:
            raise RecordingError(
                "the cuts do not determine all coefficients: measure at three feeds or more, with all three forces"
            )
        values = (Vt.T / s) @ (U.T @ y) / scale
        leverage = np.sum(U**2, axis=1).reshape(rows, 3)
        freedom = rows - leverage.sum(axis=0)
        square = np.sum((force - design @ values) ** 2, axis=0)
        new = np.maximum(square / np.maximum(freedom, 1e-9), 1e-18 * np.sum(force**2, axis=0) + 1e-30)
        if step and np.allclose(new, variance, rtol=1e-9):
            break
        variance = new
    covariance = (Vt.T / s**2) @ Vt / np.outer(scale, scale)
    return _Solution(values, covariance, variance, freedom, leverage)


def _find_outlier(design: Array, force: Array, solution: _Solution) -> tuple[int, str] | None:
    """Return the row with the largest externally studentised residual above the threshold, and the reason."""
    from scipy.special import stdtrit

    residual = force - design @ solution.values
    own = np.maximum(1.0 - solution.leverage, 1e-9)
    inner = residual / np.sqrt(solution.variance * own)
    freedom = solution.freedom
    if (freedom <= 1.5).any():
        return None
    room = np.maximum(freedom - inner**2, 1e-9)
    outer = np.abs(inner) * np.sqrt((freedom - 1.0) / room)
    bound = stdtrit(freedom - 1.0, 1.0 - OUTLIER_LEVEL / (2.0 * residual.size))
    excess = outer / bound
    row, component = np.unravel_index(int(np.argmax(excess)), excess.shape)
    if excess[row, component] <= 1.0:
        return None
    return int(row), (
        f"outlier: the {COMPONENTS[component]} force is {residual[row, component]:+.3g} N off the fit, "
        f"{outer[row, component]:.1f} standard deviations"
    )


def _count_outliers(reasons: list[str]) -> int:
    return sum(reason.startswith("outlier") for reason in reasons)


def _compute_intervals(solution: _Solution, design: Array, level: float) -> tuple[Array, Array]:
    from scipy.special import stdtrit

    information = np.einsum("nck,nck->ck", design, design) / solution.variance[:, None]
    is_observed = information > 0.05 * information.sum(axis=0)  # components with a share in a coefficient
    freedom = np.where(is_observed, np.maximum(solution.freedom, 1e-3)[:, None], np.inf).min(axis=0)
    half = stdtrit(freedom, 0.5 + 0.5 * level) * np.sqrt(np.diag(solution.covariance))
    return solution.values - half, solution.values + half


def _find_negative_coefficient(values: Array, high: Array, free: Bools) -> int | None:
    """Return a coefficient that is negative within its interval; refuse what is negative beyond it."""
    index = np.flatnonzero(free)
    for n in range(len(values)):
        if values[n] < 0.0 <= high[n] and index[n] > 0:
            return int(index[n])
    wrong = [NAMES[index[n]] for n in range(len(values)) if high[n] < 0.0]
    if wrong:
        raise RecordingError(
            f"{', '.join(wrong)} would be negative, beyond the interval: the forces have another sign or frame. "
            "Check force_on (tool or workpiece), wrench_frame, cut, spindle and helix_deg (right-hand +)"
        )
    return None


@dataclass(frozen=True, kw_only=True)
class _ForceEquations:
    """The equations of N cuts and which of them and of the coefficients are used."""

    design: Array  # (N, 3, 6) force per N/mm² and N/mm
    force: Array  # (N, 3) N
    feed_per_tooth: Array  # (N,) m
    free: Bools  # (6,) False: the coefficient is set to 0
    reasons: list[str]  # (N,) why a row is not used; empty where it is

    @property
    def used(self) -> Bools:
        """(N,) rows that are used."""
        return np.array([not reason for reason in self.reasons])


def _list_fit_warnings(equations: _ForceEquations, interval: tuple[Array, Array], level: float) -> list[str]:
    """Return warnings of coefficients whose interval includes negative values, and of too few feeds."""
    fz = equations.feed_per_tooth[equations.used]
    warnings = [
        f"{NAMES[n]} is not determined: its {100 * level:g} % interval is {low:.3g} … {high:.3g}"
        for n, low, high in zip(np.flatnonzero(equations.free), *interval, strict=True)
        if low < 0.0
    ]
    if len(np.unique(np.round(fz / fz.max(), 3))) < 3:
        warnings.append("two feeds only: a misfit of the linear law cannot be seen; three or more would show it")
    return warnings


def _build_fit(
    equations: _ForceEquations,
    solution: _Solution,
    interval: tuple[Array, Array],
    level: float,
    warnings: tuple[str, ...],
) -> CoefficientFit:
    design, force, free, used = equations.design, equations.force, equations.free, equations.used
    values, covariance, low, high = np.zeros(6), np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    values[free], low[free], high[free] = solution.values, *interval
    covariance[np.ix_(free, free)] = solution.covariance
    predicted = design @ values
    seen, shown = force[used], predicted[used]
    square = np.sum((seen - shown) ** 2, axis=0)
    about = np.sum((seen - seen.mean(axis=0)) ** 2, axis=0)
    doubt = np.einsum("nck,kl,ncl->n", design[used], covariance, design[used])
    resultant = np.sum(shown**2, axis=1)
    relative = math.sqrt(float(np.mean((doubt + np.sum((seen - shown) ** 2, axis=1)) / resultant)))
    return CoefficientFit(
        values=values,
        covariance=covariance,
        low=low,
        high=high,
        level=level,
        fixed=tuple(NAMES[n] for n in np.flatnonzero(~free)),
        measured=np.array(force),
        predicted=predicted,
        feed_per_tooth=equations.feed_per_tooth,
        used=used,
        reasons=tuple(equations.reasons),
        residual=np.sqrt(solution.variance),
        explained=1.0 - square / np.where(about > 0.0, about, np.inf),
        sigma_log=math.log1p(relative),
        warnings=warnings,
    )
