"""Interface of a limit on configurations beside joint ranges and singularities, which keeps them out of every step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.planning.stations.planning_path import PlanningPath

if TYPE_CHECKING:
    from machopt.planning.sampling.configurations import PlanningArm


class ConfigurationLimit(Protocol):
    """Limit that the process sets to the stability of the cut."""

    ratio: float  # least permitted limit of the depth of cut over the planned depth

    def compute_ratios(self, arm: PlanningArm, path: PlanningPath, points: NDArray[np.intp], q: Array) -> Array:
        """Return (M,) the limit of the depth of cut over the planned depth; inf where nothing limits it.

        Args:
            arm: arm model.
            path: planning points.
            points: (M,) planning points.
            q: (M, 6) rad.
        """

    def find_violations(self, arm: PlanningArm, path: PlanningPath, points: NDArray[np.intp], q: Array) -> Bools:
        """Return (M,) configurations that violate the limit.

        Args:
            arm: arm model.
            path: planning points.
            points: (M,) planning points.
            q: (M, 6) rad.
        """
