"""Inclinometer on a link together with measured poses: two further equations per reading.

It measures the rotation of the link about x and y of base_link relative to the encoder model. Base, joints up to the
link, and links up to its own contribute (the inclinometer is assumed at the link's far end). Neither bodies behind
the link nor the tracker frame contribute, so base and tracker frame become separable. Two zero offsets per session
are refitted. The nominal deflection is exact, with finite rotations and the corrections of kinematics.yaml.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.effect_locations import LINK, parse_location
from machopt.data_types.measurements.recording import Recording
from machopt.errors import RecordingError
from machopt.kinematics.robot import ArmState
from machopt.kinematics.urdf_loading import find_frame, load_urdf_model
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import BaseUnknown, Flags
from machopt.measurement.diagnosis.data_types.diagnosis_result import compute_rms
from machopt.measurement.diagnosis.data_types.static_readings import InclinometerSetup
from machopt.measurement.diagnosis.static.measured_pose_model import FirstPoseFit, NominalPoseModel
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import convert_to_rotation_vector

ColumnAssignment = Callable[[Array], Array]  # alternative reading of two columns (n, 2)

FAMILY = "tilt"
AXES = "xy"
UNITS = {
    "degrees": 180e-3 / np.pi,
    "rad": 1e-3,
    "arcsec": 648.0 / np.pi,
}  # factors of values in these units read as mrad


@dataclass(frozen=True)
class InclinometerEquations:
    """Equations that an inclinometer adds to a problem."""

    y: Array  # (N, 2) rad, zero if not measured
    columns: Array  # (N, 2, P) columns of the pose unknowns
    levels: Array  # (N, 2, 2 S) columns of the zero offsets of each session
    unknowns: list[BaseUnknown]  # the zero offsets

    def append_columns(self, base: Array) -> Array:
        """Append the inclinometer's columns to base columns of poses.

        Args:
            base: (N, D, P) columns.

        Returns:
            (N, D + 2, P + 2 S) columns.
        """
        none = np.zeros((*base.shape[:2], self.levels.shape[2]))
        return np.concatenate(
            [np.concatenate([base, none], axis=2), np.concatenate([self.columns, self.levels], axis=2)], axis=1
        )


def find_inclinometer(recording: Recording, cell: Cell) -> InclinometerSetup | None:
    """Find the link of the inclinometer and the readings that contain a tilt.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        cell: Robot cell.

    Returns:
        The set-up; None without tilts.

    Raises:
        InputError: ``tilt_link`` is no link of the arm.
    """
    if recording.tilt is None or not np.isfinite(recording.tilt).any():
        return None
    return InclinometerSetup(
        find_inclinometer_link(recording.tilt_link, cell, recording.source), np.isfinite(recording.tilt)
    )


def find_inclinometer_link(name: str, cell: Cell, source: str = "") -> int:
    """Find the joint (1-based) that moves a link; 0 for a body fixed to base_link.

    Args:
        name: Link name of the URDF, or the joint number ("3" or "link:3").
        cell: Robot cell.
        source: Source of the recording, for error messages.

    Returns:
        Joint number.

    Raises:
        InputError: There is no such link, or it belongs neither to the arm nor to base_link.
    """
    at = parse_location(name)
    number = at.which if at.kind == LINK else name
    if number.isdecimal() and int(number) <= len(cell.arm_joints):
        return int(number)
    model = load_urdf_model(cell)
    links = [f.name for f in model.frames if str(f.type) == "BODY"]
    if name not in links:
        raise RecordingError(
            f"tilt_link {name!r} is no link of the robot; expected one of {', '.join(links)}, or the number of the "
            f"joint that moves it, 0 … {len(cell.arm_joints)}",
            file=source or None,
        )
    arm = [model.getJointId(joint) for joint in cell.arm_joints]
    fixed = model.frames[find_frame(cell, model, cell.base_link)].parentJoint
    joint = model.frames[find_frame(cell, model, name)].parentJoint
    while joint not in (0, fixed, *arm):
        joint = model.parents[joint]
    if joint in arm:
        return arm.index(joint) + 1
    if joint != fixed:
        raise RecordingError(
            f"tilt_link {name!r} is neither fixed to {cell.base_link} nor moved by the arm; expected a link that is",
            file=source or None,
        )
    return 0


def compute_link_sag(model: NominalPoseModel, state: ArmState, link: int) -> Array:
    """Compute the rotation of a link of the nominal arm relative to the encoder model: corrections and deflection.

    Args:
        model: Nominal pose model.
        state: State at the loaded equilibrium.
        link: Joint number that moves the link.

    Returns:
        (N, 3) rotation vectors, rad.

    Raises:
        ValueError: The state has no body poses.
    """
    plain = model.encoders.compute_state(model.recording.q, model.cell.tool.T_flange_tcp, bodies=True)
    if state.R_bodies is None or plain.R_bodies is None:
        raise ValueError("the state was made without its bodies")
    turned = state.R_bodies[:, link] @ np.swapaxes(plain.R_bodies[:, link], 1, 2)
    return convert_to_rotation_vector(turned)


def _check_tilt_columns(recording: Recording, inclined: InclinometerSetup, sag: Array, state: ArmState) -> None:
    """Raise an error if tilts equal the nominal deflection in another column order or unit."""
    if recording.tilt is None or state.R_bodies is None:
        return
    rows = inclined.present.all(axis=1)
    session = np.unique(recording.session[rows], return_inverse=True)[1].reshape(-1)

    def apart(values: Array) -> Array:
        mean = np.stack([np.bincount(session, v) for v in values.T], axis=1) / np.bincount(session)[:, None]
        return np.asarray(values - mean[session])

    if rows.sum() < thresholds.COUNTS.min_groups:
        return
    R = state.R_bodies[rows, inclined.link]
    seen, there = apart(recording.tilt[rows]), apart(sag[rows, :2])
    own = apart(np.einsum("nji,nj->ni", R, sag[rows])[:, :2])
    flips = {"": (1, 1), ", x reversed": (-1, 1), ", y reversed": (1, -1), ", both reversed": (-1, -1)}
    ways = {f"in axes of base_link{words}": there * sign for words, sign in flips.items()}
    ways |= {f"x and y exchanged{words}": there[:, ::-1] * sign for words, sign in flips.items()}
    ways |= {f"in axes of the link{words}": own * sign for words, sign in flips.items()}
    ways |= {f"in {unit}": there * factor for unit, factor in UNITS.items()}
    left = {
        words: compute_rms(seen - values) / compute_rms(values) if values.any() else np.inf
        for words, values in ways.items()
    }
    right, best = next(iter(left)), min(left, key=lambda words: left[words])
    if left[right] > thresholds.SHARES.half_power_amplitude and left[best] < thresholds.SHARES.minority:
        raise RecordingError(
            f"tilt_x_mrad, tilt_y_mrad are what weight does to link {recording.tilt_link} {best} (it leaves "
            f"{100 * left[best]:.0f} %); expected rotations about x and y of base_link, in mrad, beyond the encoders",
            file=recording.source,
        )


def mark_measured_coordinates(dimensions: int, inclined: InclinometerSetup) -> Flags:
    """Return which coordinates were measured, including those of the inclinometer.

    Args:
        dimensions: Number of pose coordinates.
        inclined: Inclinometer set-up.

    Returns:
        (N, D + 2) True if measured.
    """
    poses = np.ones((len(inclined.present), dimensions), bool)
    return np.concatenate([poses, inclined.present], axis=1)


def build_inclinometer_equations(
    model: NominalPoseModel,
    frame: FirstPoseFit,
    state: ArmState,
    inclined: InclinometerSetup,
    unknowns: Sequence[BaseUnknown],
) -> InclinometerEquations:
    """Build the inclinometer's equations about the first fit. Spring coefficients are totals, as for the poses.

    Args:
        model: Nominal pose model.
        frame: Result of the first fit.
        state: State at the loaded equilibrium.
        inclined: Inclinometer set-up.
        unknowns: Unknowns of the pose columns.

    Returns:
        The equations.
    """
    recording, k = model.recording, inclined.link
    assert recording.tilt is not None  # where checks it
    turning, torque = state.J[:, 3:5, :k], model.compute_torque(state)
    there = inclined.present.astype(float)
    columns = np.zeros((len(there), 2, len(unknowns)))
    sag = compute_link_sag(model, state, k)
    _check_tilt_columns(recording, inclined, sag, state)
    y = np.nan_to_num(recording.tilt) - sag[:, :2]
    for n, u in enumerate(unknowns):
        if u.spring_joint is None or u.spring_joint > k:
            continue
        columns[:, :, n] = turning[:, :, u.spring_joint - 1] * torque[:, u.spring_joint - 1 : u.spring_joint]
        y += columns[:, :, n] * frame.compliance[u.spring_joint - 1]
    names, session = np.unique(recording.session, return_inverse=True)
    levels = np.zeros((len(there), 2, len(names), 2))
    for c in range(2):
        levels[np.arange(len(there)), c, session.reshape(-1), c] = 1.0
    of = [f" of session {name}" if len(names) > 1 else "" for name in names]
    own = [BaseUnknown(name=f"level {a}{words}", unit="rad", location="level") for words in of for a in AXES]
    levels = levels.reshape(len(there), 2, -1) * there[:, :, None]
    read = levels.any(axis=(0, 1))  # a session without inclinometer readings has no zero offset
    return InclinometerEquations(
        y * there,
        columns * there[:, :, None],
        levels[:, :, read],
        [u for u, is_read in zip(own, read, strict=True) if is_read],
    )
