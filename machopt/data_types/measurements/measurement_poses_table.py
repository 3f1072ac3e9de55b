"""Table of the poses to measure, in order."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.numerics.array_types import Array, Ints


@dataclass(frozen=True, kw_only=True)
class PosesTable:
    """One row a load cycle (unloaded, loaded, unloaded), in the order of work; SI, base_link axes."""

    pose: Ints  # (N,) label, from 1
    cycle: Ints  # (N,) label, from 1 at each pose
    session: Ints  # (N,) round over all poses, from 1
    q: Array  # (N, 6) rad
    load: tuple[str, ...]  # (N,) in words
    wrench: Array  # (N, 6) N, N·m at the TCP
    position: Array  # (N, 3) m, TCP
    displacement: Array  # (N, 3) m expected, or (N, 6) with rotations in rad
    kci: Array  # (N,)
    nu_p: Array  # (N,)
    nu_r: Array  # (N,) rad
    clearance: Array  # (N,) m to the nearest body; NaN where not looked for
    load_point: Array  # (N, 3) m, where the load acts
    way_free: tuple[bool | None, ...]  # (N,) straight joint motion from the row before; None: not looked for

    def __len__(self) -> int:
        return len(self.pose)
