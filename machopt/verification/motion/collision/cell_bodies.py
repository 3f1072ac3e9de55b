"""Collision bodies of a cell with the pairs that count, kept for processes that verify plans of one cell repeatedly."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from machopt.data_types.cell import Cell, list_geometry_files, select_geometry
from machopt.numerics.content_cache import ContentCache
from machopt.verification.motion.collision.bodies import CoalBody, build_bodies
from machopt.verification.motion.collision.clearance_column import list_varying_pairs
from machopt.verification.motion.collision.touching_pairs import list_checked_pairs
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

MAX_SELECTIONS = 16  # selections of pairs that are kept for one cell
BodyPair = tuple[CoalBody, CoalBody]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class CellBodies:
    """Bodies of one cell; a selection of pairs samples hundreds of poses, which are the same each time."""

    bodies: list[CoalBody]
    _selections: dict[Hashable, Any] = field(default_factory=dict)

    def list_checked_pairs(
        self, cell: Cell, arm: UrdfKinematics, clearance: float, touching: Sequence[tuple[str, str]] | None
    ) -> tuple[list[BodyPair], list[str]]:
        """Return the pairs that must not touch, and those that the manifest lists without reason.

        Args:
            cell: The robot cell.
            arm: Kinematics of its URDF with its tool.
            clearance: Required clearance, m.
            touching: Names of bodies as the manifest lists them; None: it lists none.
        """
        key = clearance, None if touching is None else tuple(tuple(pair) for pair in touching)
        return self._select(key, lambda: list_checked_pairs(cell, arm, self.bodies, clearance, touching))

    def list_varying_pairs(self, arm: UrdfKinematics, pairs: list[BodyPair]) -> list[BodyPair]:
        """Return the pairs whose distance changes.

        Args:
            arm: Kinematics of the URDF with the cell's tool.
            pairs: Pairs of these bodies.
        """
        key = tuple((id(a), id(b)) for a, b in pairs)
        return self._select(key, lambda: list_varying_pairs(arm, pairs))

    def _select(self, key: Hashable, compute: Callable[[], T]) -> T:
        if key not in self._selections:
            if len(self._selections) >= MAX_SELECTIONS:
                self._selections.clear()
            self._selections[key] = compute()
        found: T = self._selections[key]
        return found


BODIES: ContentCache[CellBodies] = ContentCache()
"""Bodies by all that they depend on: a mesh of other bytes, or another tool, gives other bodies."""


def load_cell_bodies(cell: Cell, arm: UrdfKinematics) -> CellBodies:
    """Return the collision bodies of a cell as pinocchio and coal load them.

    Args:
        cell: The robot cell.
        arm: Kinematics of its URDF with its tool.

    Raises:
        OutputFolderError: a body of the URDF cannot be loaded.
    """
    bare = replace(select_geometry(cell), files=list_geometry_files(cell))
    return BODIES.get((bare, cell.urdf_text), lambda: CellBodies(build_bodies(cell, arm)))
