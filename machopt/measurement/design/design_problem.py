"""Problem of an experiment design: poses, loads, models with their probabilities, and the chosen readings."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from machopt.numerics.array_types import Array, Ints


@dataclass(frozen=True)
class ModelBelief:
    """One prior model of the N readings."""

    response: Array  # (N, D, P)
    covariance: Array  # (N, D, D) noise of each reading
    weight: float = 1.0


@dataclass(frozen=True)
class DesignProblem:
    """Candidate readings and the models that they inform."""

    models: tuple[ModelBelief, ...]
    pose: Ints  # (N,) ascending
    shared: Array  # (D, D) covariance of the pose error

    def select_poses(self, poses: Ints) -> tuple[DesignProblem, Ints]:
        """Restrict the problem to some poses.

        Args:
            poses: Pose labels.

        Returns:
            The restricted problem, and the indices of its readings in this one.
        """
        rows = np.flatnonzero(np.isin(self.pose, poses))
        models = tuple(replace(m, response=m.response[rows], covariance=m.covariance[rows]) for m in self.models)
        return DesignProblem(models, self.pose[rows], self.shared), rows


@dataclass(frozen=True)
class ReadingDesign:
    """Selected readings by pose, in the order of selection."""

    blocks: tuple[tuple[int, ...], ...]  # indices of readings; one tuple per pose
    value: float  # Σ w log det
    history: tuple[float, ...] = field(default=(), compare=False)  # value after every accepted exchange

    @property
    def readings(self) -> Ints:
        return np.array([n for block in self.blocks for n in block], np.int64)


def index_readings_by_pose(pose: Ints) -> Ints:
    """Index the readings of each pose.

    Args:
        pose: (N,) pose labels, ascending.

    Returns:
        (poses, L) reading indices, −1 as padding.
    """
    _, start, count = np.unique(pose, return_index=True, return_counts=True)
    column = np.arange(count.max())
    return np.asarray(np.where(column < count[:, None], start[:, None] + column, -1), np.int64)
