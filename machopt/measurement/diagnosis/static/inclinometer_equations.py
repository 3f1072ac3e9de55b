"""An inclinometer on a link beside measured poses: two further equations a reading, of what turns that link.

It reads how the link is turned about x and y of base_link beyond what the encoders say: base, joints up to the link's,
links up to its own (at whose far end it is taken to sit). Nothing behind the link turns it, nor does where the tracker
stands, so base and tracker frame are told apart. Its own level is refitted: two offsets a session.

What the nominal arm does counts exactly, finite rotations and corrections of kinematics.yaml included.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.locations import LINK, parse_location
from machopt.data_types.measurements.recording import Recording
from machopt.errors import InputError
from machopt.kinematics.robot import ArmState, find_frame, load_urdf_model
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import BaseUnknown, Flags
from machopt.measurement.diagnosis.data_types.diagnosis_result import compute_rms
from machopt.measurement.diagnosis.data_types.static_readings import InclinometerSetup
from machopt.measurement.diagnosis.static.nominal_pose_model import FirstPoseFit, NominalPoseModel
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import convert_to_rotation_vector

ColumnAssignment = Callable[[Array], Array]  # two columns (n, 2) read otherwise

FAMILY = "tilt"
AXES = "xy"
UNITS = {"degrees": 180e-3 / np.pi, "rad": 1e-3, "arcsec": 648.0 / np.pi}  # numbers of these taken for mrad


@dataclass(frozen=True)
class InclinometerEquations:
    """What the inclinometer adds to a problem."""

    y: Array  # (N, 2) rad, zero where it was not read
    columns: Array  # (N, 2, P) of the unknowns of the poses
    levels: Array  # (N, 2, 2 S) of its own: the level of each session
    unknowns: list[BaseUnknown]  # of the levels

    def append_columns(self, base: Array) -> Array:
        """(N, D + 2, P + 2 S) of columns (N, D, P) of poses."""
        none = np.zeros((*base.shape[:2], self.levels.shape[2]))
        return np.concatenate(
            [np.concatenate([base, none], axis=2), np.concatenate([self.columns, self.levels], axis=2)], axis=1
        )


def find_inclinometer(recording: Recording, cell: Cell) -> InclinometerSetup | None:
    """The link and the readings that have a tilt; None where none has.

    Raises:
        InputError: ``tilt_link`` is no link of the arm.
    """
    if recording.tilt is None or not np.isfinite(recording.tilt).any():
        return None
    return InclinometerSetup(
        find_inclinometer_link(recording.tilt_link, cell, recording.source), np.isfinite(recording.tilt)
    )


def find_inclinometer_link(name: str, cell: Cell, source: str = "") -> int:
    """The joint, from 1, that moves a link; 0 for what stands with base_link.

    Args:
        name: of the URDF, or that number itself ("3" or "link:3").

    Raises:
        InputError: no such link, or one that neither the arm moves nor base_link holds.
    """
    at = parse_location(name)
    number = at.which if at.kind == LINK else name
    if number.isdecimal() and int(number) <= len(cell.arm_joints):
        return int(number)
    model = load_urdf_model(cell)
    links = [f.name for f in model.frames if str(f.type) == "BODY"]
    if name not in links:
        raise InputError(
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
        raise InputError(
            f"tilt_link {name!r} neither stands with {cell.base_link} nor is moved by the arm; expected a link that is",
            file=source or None,
        )
    return 0


def compute_link_sag(model: NominalPoseModel, state: ArmState, link: int) -> Array:
    """(N, 3) rad, how far the nominal arm's link is from where the encoders say: corrections and sag."""
    plain = model.encoders.compute_state(model.recording.q, model.cell.tool.T_flange_tcp, bodies=True)
    if state.R_bodies is None or plain.R_bodies is None:
        raise ValueError("the state was made without its bodies")
    turned = state.R_bodies[:, link] @ np.swapaxes(plain.R_bodies[:, link], 1, 2)
    return convert_to_rotation_vector(turned)


def _check_tilt_columns(recording: Recording, inclined: InclinometerSetup, sag: Array, state: ArmState) -> None:
    """Refuse tilts that are what weight does to the link, written down otherwise: no physics is to be made of that."""
    if recording.tilt is None or state.R_bodies is None:
        return
    rows = inclined.present.all(axis=1)
    session = np.unique(recording.session[rows], return_inverse=True)[1].reshape(-1)

    def apart(values: Array) -> Array:
        mean = np.stack([np.bincount(session, v) for v in values.T], axis=1) / np.bincount(session)[:, None]
        return np.asarray(values - mean[session])

    if rows.sum() < thresholds.RECORD.tilt_readings:
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
    if left[right] > thresholds.RECORD.tilt_wrong and left[best] < thresholds.RECORD.tilt_like:
        raise InputError(
            f"tilt_x_mrad, tilt_y_mrad are what weight does to link {recording.tilt_link} {best} (it leaves "
            f"{100 * left[best]:.0f} %); expected rotations about x and y of base_link, in mrad, beyond the encoders",
            file=recording.source,
        )


def mark_measured_coordinates(dimensions: int, inclined: InclinometerSetup) -> Flags:
    """(N, D + 2) what was measured beside ``dimensions`` of the pose."""
    poses = np.ones((len(inclined.present), dimensions), bool)
    return np.concatenate([poses, inclined.present], axis=1)


def build_inclinometer_equations(
    model: NominalPoseModel,
    frame: FirstPoseFit,
    state: ArmState,
    inclined: InclinometerSetup,
    unknowns: Sequence[BaseUnknown],
) -> InclinometerEquations:
    """The inclinometer's equations about the first fit; coefficients of springs are totals, as in the poses'.

    Args:
        model: of the poses.
        frame: what the first fit found.
        state: the arm in equilibrium there.
        inclined: where the inclinometer sits.
        unknowns: of the poses' columns.
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
    read = levels.any(axis=(0, 1))  # a session without a reading of the inclinometer has no level
    return InclinometerEquations(
        y * there,
        columns * there[:, :, None],
        levels[:, :, read],
        [u for u, is_read in zip(own, read, strict=True) if is_read],
    )
