"""Numbers of one window: nodes, limits, loads and the nominal error that each node may have."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools


@dataclass(frozen=True, kw_only=True)
class NodeLoads:
    """Load and tolerance at N nodes, in the workpiece frame; a node without a tolerance has an infinite limit."""

    compliance: Array  # (N, 6) rad/(N·m) of the joints' own springs
    edge: Array  # (N, 6) N and N·m, load without feed
    slope: Array  # (N, 6) N·s/m and N·s, change of the load by the feed in m/s
    normal: Array  # (N, 3) unit, surface normal; zero where there is no tolerance
    highest: Array  # (N,) m/s, feed up to which the cutting coefficients hold; inf: no limit
    limit: Array  # (N,) m, permitted nominal error by the joints' springs; inf: none


@dataclass(frozen=True, kw_only=True)
class LocalLimits:
    """Values that must stay above zero at N nodes, linear in the rotation and the external joints at an iterate.

    One column per quantity: distance of the nearest bodies beyond the clearance, margins to the singularities, depth
    limit of chatter beyond the planned depth. Each is divided by a typical size.
    """

    value: Array  # (N, m)
    by_phi: Array  # (N, m) per rad
    by_external: Array  # (N, m, E) per rad or m

    @property
    def count(self) -> int:
        """Number m of quantities."""
        return int(self.value.shape[1])


@dataclass(frozen=True, kw_only=True)
class WindowData:
    """N nodes of a window and everything that its solution follows from."""

    points: NDArray[np.intp]  # (N,) planning points
    x: Array  # (N, 6 + E) rad or m, joints of the present plan
    phi: Array  # (N,) rad, rotation of the present plan
    position: Array  # (N, 3) m, TCP in the workpiece frame
    frame: Array  # (N, 3, 3) TCP axes at phi = 0 in the workpiece frame
    way: Array  # (N − 1,) m, metric length of each segment, above zero
    length: Array  # (N − 1,) m, length of the tip's path
    cap: Array  # (N − 1,) m/s along the metric: feed limit
    velocity: Array  # (6 + E,) limits in use while cutting, rad/s or m/s
    acceleration: Array  # (6 + E,)
    jerk: Array  # (6 + E,)
    lower: Array  # (6 + E,) rad or m, joint limits within their margin
    upper: Array  # (6 + E,)
    phi_lower: Array  # (N,) rad, the user's range and fixed rotations within the trust region
    phi_upper: Array  # (N,)
    is_fixed: Bools  # (N,) node that keeps the present plan
    is_plunge: Bools  # (N − 1,) segment along the tool axis: the rotation is kept
    is_free: Bools  # (E,) external joints that may move
    external_trust: float  # rad or m, largest change of an external joint
    starts_at_rest: bool
    ends_at_rest: bool
    loads: NodeLoads
    limits: LocalLimits

    @property
    def has_tolerance(self) -> Bools:
        """(N,) nodes with a limit of the error."""
        return np.isfinite(self.loads.limit)


@dataclass(frozen=True, kw_only=True)
class WindowSolution:
    """Result of one window problem."""

    x: Array  # (N, 6 + E) rad or m
    phi: Array  # (N,) rad
    feed: Array  # (N − 1,) m/s along the tip's path
    time: float  # s
    is_solved: bool
    status: str  # of the solver
    iterations: int
    excess: Array = field(default_factory=lambda: np.zeros(0))  # (N,) m, error beyond the limit
