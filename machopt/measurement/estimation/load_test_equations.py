"""Load tests as equations, in base_link axes, at the TCP, in SI.

Reading n under the wrench w_n obeys δ_n = Σ_j c_j J_j(q_n) (J_j(q_n)ᵀ w_n) + Σ_p x_p B_p(q_n) w_n + error. It is
linear in the joint compliances c (dumas2011 eqs. 19–24, whose A is ``response`` without terms) and in the
coefficients x of the terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import FrameName, Recording, StandardUncertainty
from machopt.errors import RecordingError
from machopt.kinematics.robot import ArmState, Robot
from machopt.numerics.array_types import Array, Ints
from machopt.stiffness.terms import LinearTerm


@dataclass(frozen=True, kw_only=True)
class LoadTestExperiment:
    """N load tests; D = 3 (translations) or 6 (with rotations)."""

    source: str
    state: ArmState  # (N, …) at the TCP, with bodies
    T_base_tcp: Array  # (N, 4, 4)
    wrench: Array  # (N, 6) N, N·m on the robot at the TCP
    measured: Array  # (N, D) m, rad
    pose: Ints  # (N,)
    cycle: Ints  # (N,) label of the load cycle, unique over poses and sessions
    session: Ints  # (N,)
    line: Ints  # (N,) line of the data file
    uncertainty: StandardUncertainty = field(default_factory=StandardUncertainty)
    files: tuple[str, ...] = ()  # names of the data files
    file: Ints | None = None  # (N,) index into files; None: all in the first
    stated_frames: tuple[FrameName, FrameName] = (
        "base",
        "base",
    )  # stated axes of wrench and displacement
    wrench_point: Array | None = None  # (3,) m, TCP axes, from the TCP to the reference point of moments; None: the TCP

    def __len__(self) -> int:
        return len(self.measured)

    @property
    def dimensions(self) -> int:
        return int(self.measured.shape[1])

    @property
    def joint_count(self) -> int:
        """Number of joints of the arm, n."""
        return int(self.state.J.shape[2])

    @property
    def lever_length(self) -> Array:
        """Vector (N, 3) m in base_link axes from the TCP to the reference point of the recorded moments."""
        if self.wrench_point is None:
            return np.zeros((len(self), 3))
        return np.asarray(self.T_base_tcp[:, :3, :3] @ self.wrench_point)

    def format_reading_location(self, reading: int) -> str:
        """Format the location of a reading: ``line 12``, or ``run_b.csv line 12`` for several files.

        Args:
            reading: Reading index, 0-based.

        Returns:
            Text.
        """
        name = "" if self.file is None or len(self.files) < 2 else f"{self.files[self.file[reading]]} "
        return f"{name}line {self.line[reading]}"

    def select_readings(self, rows: NDArray[np.bool_] | Ints) -> LoadTestExperiment:
        """Return the selected readings.

        Args:
            rows: (N,) mask or indices of readings.

        Returns:
            The experiment with these readings.
        """
        s = self.state
        state = ArmState(
            s.q[rows],
            s.T_base_tool[rows],
            s.J[rows],
            None if s.R_bodies is None else s.R_bodies[rows],
            None if s.p_bodies is None else s.p_bodies[rows],
        )
        return replace(
            self,
            state=state,
            T_base_tcp=self.T_base_tcp[rows],
            wrench=self.wrench[rows],
            measured=self.measured[rows],
            pose=self.pose[rows],
            cycle=self.cycle[rows],
            session=self.session[rows],
            line=self.line[rows],
            file=None if self.file is None else self.file[rows],
        )

    def response(self, terms: Sequence[LinearTerm] = ()) -> Array:
        """Return the response matrix: displacement per unit of each joint compliance, then of each term's
        coefficients.

        Args:
            terms: Linear terms fitted together with the joints.

        Returns:
            (N, D, n + P) m, rad per unit of each coefficient.
        """
        J = self.state.J
        tau = np.einsum("nci,nc->ni", J, self.wrench)
        parts = [J * tau[:, None, :], *(t.compute_response(self.state, self.wrench) for t in terms)]
        return np.concatenate(parts, axis=-1)[:, : self.dimensions]


def build_load_test_experiment(recording: Recording, robot: Robot, T_flange_tcp: Array) -> LoadTestExperiment:
    """Build the equations of a recording of load tests.

    Args:
        recording: Recording of kind deflection.
        robot: Kinematic model for the joint angles ``recording.q``.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        The experiment.

    Raises:
        InputError: Another kind of recording, or no loads or displacements.
    """
    if recording.kind != "deflection" or recording.wrench is None or recording.displacement is None:
        raise RecordingError(
            f"is a recording of kind {recording.kind!r}; stiffness is identified from kind 'deflection' "
            "(loads fx_N … and displacements dx_mm …)",
            file=recording.source,
        )
    state = robot.compute_state(recording.q, T_flange_tcp, bodies=True)
    R, p = state.T_base_tool[:, :3, :3], state.T_base_tool[:, :3, 3]
    wrench, point = recording.wrench, None
    if recording.wrench_frame == "tool":
        wrench = _rotate_to_base(R, wrench)
    if recording.wrench_point is not None:  # transfer the moments from that point to the TCP
        flange = robot.compute_fk(recording.q)
        at = flange[:, :3, 3] + np.einsum("nij,j->ni", flange[:, :3, :3], recording.wrench_point)
        wrench = wrench.copy()
        wrench[:, 3:] += np.cross(at - p, wrench[:, :3])
        point = T_flange_tcp[:3, :3].T @ (recording.wrench_point - T_flange_tcp[:3, 3])
    measured = recording.displacement
    if recording.displacement_frame == "tool":
        measured = _rotate_to_base(R, measured)
    _, cycle = np.unique(
        np.stack([recording.session, recording.pose, recording.cycle], axis=1), axis=0, return_inverse=True
    )
    return LoadTestExperiment(
        source=recording.source,
        state=state,
        T_base_tcp=state.T_base_tool,
        wrench=wrench,
        measured=measured,
        pose=recording.pose,
        cycle=cycle.reshape(-1).astype(np.int64),
        session=recording.session,
        line=recording.line,
        uncertainty=recording.uncertainty,
        files=recording.files,
        file=recording.file,
        stated_frames=(recording.wrench_frame, recording.displacement_frame),
        wrench_point=point,
    )


def _rotate_to_base(R: Array, v: Array) -> Array:
    """(N, 3) or (N, 6) vectors from TCP axes to base axes."""
    parts = [np.einsum("nij,nj->ni", R, v[:, a : a + 3]) for a in range(0, v.shape[1], 3)]
    return np.concatenate(parts, axis=1)
