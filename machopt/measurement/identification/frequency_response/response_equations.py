"""What the receptance of a row follows from beside the unknowns: mass matrix, directions at the joints, noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.frequency_response_recording import FrequencyResponseRecording
from machopt.data_types.stiffness import LEAST_STIFFNESS
from machopt.dynamics.rigid_body import load_dynamics
from machopt.errors import RecordingError
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.numerics.array_types import Array, ComplexArray, Ints, make_arrays_read_only

COHERENCE_RANGE = (1e-9, 0.9999)  # above, the rest is rounding; below, a response at an antiresonance is divided by 0
NOISE_LINES = 3  # neighbours to either side over which the noise is averaged: that of few blows scatters by itself
TYPICAL_DAMPING = 0.06  # loss factor of a robot joint: twice the modal damping of 3 % of published arms


@dataclass(frozen=True, kw_only=True)
class ResponseEquations:
    """N rows; one mass matrix and one pair of directions a row."""

    omega: Array  # (N,) rad/s
    receptance: ComplexArray  # (N,) m/N
    shape: Array  # (N,) relative standard deviation of real and imaginary part within a response, up to its scale
    group: Ints  # (N,) number of the response
    mass: Array  # (N, 6, 6) kg·m², rotors locked
    body_mass: Array  # (6, N, 6, 6) part of each link
    response: Array  # (N, 6) m/rad, J_vᵀ d of the sensor
    excitation: Array  # (N, 6) m/rad, J_vᵀ d of the force
    q: Array  # (N, 6) rad

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    @property
    def reference(self) -> float:
        """Frequency ω_0 at which both damping laws are the same, rad/s."""
        return float(np.median(self.omega))


def build_response_equations(
    recording: FrequencyResponseRecording, cell: Cell, robot: Robot, prior: Array | None
) -> ResponseEquations:
    """Return the equations of a recording.

    Args:
        recording: Measured responses.
        cell: For masses and tool.
        robot: Kinematic model.
        prior: (6,) N·m/rad, stiffness of the cell, to recognise wrong units; None: unknown.

    Raises:
        InputError: No masses in the URDF, or responses in another unit.
    """
    dynamics = load_dynamics(cell)
    parts = dynamics.compute_body_mass_matrices(recording.q)
    H, size = recording.receptance, np.abs(recording.receptance)
    spread = size
    if recording.coherence is not None:  # output noise per input: |H|² (1 − γ²)/γ²
        gamma = np.clip(recording.coherence, *COHERENCE_RANGE)
        spread = np.sqrt(_smooth_along_frequency(recording, size**2 * (1.0 - gamma) / gamma))
    else:
        usual = np.array([np.sqrt(np.mean(size[recording.group == n] ** 2)) for n in range(recording.responses)])
        spread = usual[recording.group]
    equations = ResponseEquations(
        omega=2.0 * math.pi * recording.frequency,
        receptance=np.array(H),
        shape=np.array(spread),
        group=np.array(recording.group),
        mass=parts.sum(axis=0),
        body_mass=parts,
        response=_compute_lever(recording, cell, robot, recording.response, recording.response_point),
        excitation=_compute_lever(recording, cell, robot, recording.excitation, recording.excitation_point),
        q=np.array(recording.q),
    )
    _refuse_wrong_units(recording, equations, prior)
    return equations


def _smooth_along_frequency(recording: FrequencyResponseRecording, variance: Array) -> Array:
    """Return the running mean of the noise of each response over its neighbouring frequencies, (N,)."""
    out = np.empty_like(variance)
    for n in range(recording.responses):
        rows = np.flatnonzero(recording.group == n)
        rows = rows[np.argsort(recording.frequency[rows])]
        sums = np.concatenate([[0.0], np.cumsum(variance[rows])])
        at = np.arange(len(rows))
        low, high = np.maximum(at - NOISE_LINES, 0), np.minimum(at + NOISE_LINES + 1, len(rows))
        out[rows] = (sums[high] - sums[low]) / (high - low)
    return out


def _compute_lever(
    recording: FrequencyResponseRecording, cell: Cell, robot: Robot, direction: Array, point: Array | None
) -> Array:
    """Return J_vᵀ d at a point, (N, 6) m/rad."""
    T = np.array(cell.tool.T_flange_tcp)
    if recording.frame == "tool":
        direction = np.einsum("nij,nj->ni", robot.compute_fk(recording.q, T)[:, :3, :3], direction)
    if point is not None:
        T[:3, 3] = point
    J = robot.compute_fk_jacobian(recording.q, T)[1][:, :3]
    return np.asarray(np.einsum("nij,ni->nj", J, direction))


def _refuse_wrong_units(
    recording: FrequencyResponseRecording, equations: ResponseEquations, prior: Array | None
) -> None:
    """Refuse receptances that no arm of this size has, or that are far from the cell's own."""
    size = np.abs(recording.receptance)
    softest = np.sum(np.abs(equations.response * equations.excitation), axis=1) / LEAST_STIFFNESS
    hint = "expected displacement over force in m/N (mm/N are 1000 times as large; accelerance and mobility are others)"
    where = "columns re_m_per_N, im_m_per_N"
    if np.median(size) > np.median(softest) > 0.0:
        raise RecordingError(
            f"half of the responses exceed {np.median(size):.3g} m/N; an arm with {LEAST_STIFFNESS:g} N·m/rad in every "
            f"joint has {np.median(softest):.3g} m/N: {hint}",
            file=recording.files[0],
            where=where,
        )
    if prior is None:
        return
    Z = np.eye(6) * (prior * (1.0 + 1j * TYPICAL_DAMPING)) - equations.omega[:, None, None] ** 2 * equations.mass
    model = np.einsum("ni,ni->n", equations.response, np.linalg.solve(Z, equations.excitation[..., None])[..., 0])
    ratio = float(np.exp(np.median(np.log(size / np.maximum(np.abs(model), 1e-300)))))
    most = thresholds.RATIOS.impossible
    if not 1.0 / most < ratio < most:
        raise RecordingError(
            f"the responses are {ratio:.3g} times those of the cell's stiffness (the median of all rows): {hint}",
            file=recording.files[0],
            where=where,
        )
