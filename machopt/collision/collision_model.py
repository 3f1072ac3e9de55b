"""Collision model of a cell: contacts and distances of robot, tool, cutter, workpiece, obstacles.

Exact triangle distances cost 0.05–5 ms, so they are computed only where cheap bounds are not sufficient. Contacts
found along a motion are confirmed by fcl:

1. Spheres around one body and a box around the other bound every pair's distance from below, for all rows
   at once in NumPy.
2. A known distance stays useful: the joint step bounds the relative motion of the bodies, so
   d(later) ≥ d(known) − motion since. The same bound proves the motion *between* two rows free: it is when
   d(a) + d(b) − 2·clearance exceeds it (each free ball covers its share of the motion); otherwise the segment is
   halved until it does or a contact is found.

Both bounds are in :mod:`machopt.collision.distance_bounds`. With external axes everything is relative to the part:
bodies move with the links of the machine's chain (:mod:`machopt.kinematics.machine`), and the hall is one of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.collision.bodies import (
    CONTACT_TOLERANCE_M,
    CollisionBody,
    build_cell_bodies,
    build_cutter_body,
    build_robot_bodies,
    count_links_between,
    list_adjacent_pairs,
    list_allowed_contacts,
    list_candidate_pairs,
)
from machopt.collision.collision_pairs import (
    CollisionContacts,
    CollisionPair,
    ExcludedCollisionPair,
    build_no_contacts,
    suggest_remedy,
)
from machopt.collision.distance_bounds import BodyPairs, DistanceMemory, MotionRows, refine_motion
from machopt.collision.fcl_distance import FclSurfaces
from machopt.collision.nearest_pair import MAX_DISTANCE_M, NearestPairs, find_nearest_pairs
from machopt.collision.pair_motion_check import PairMotionCheck
from machopt.collision.proximity_test import build_outline, is_nearer_than
from machopt.data_types.cell import Cell
from machopt.kinematics.machine import load_machine
from machopt.kinematics.machine_lines import LinkCarriers, MachineLines
from machopt.kinematics.robot import LinkShape, Robot
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.parallel_map import map_in_threads

RANDOM_POSES = 400  # random poses that decide which link pairs are worth checking
ADJACENT_CONTACT_SHARE = 0.95  # share of poses in contact from which a pair counts as in contact by construction
TWO_APART_CONTACT_SHARE = 0.50  # the same for links two apart, whose meshes often overlap where the real links do not
MAX_BOUNDED_STEP_RAD = 0.1  # rad, joint step above which the motion bound is useless
SORTING_STRIP_RAD = np.radians(2.0)  # strip of a joint in which poses are sorted by the next one
MAX_BLOCK_ROWS = 50_000  # rows of a motion per block, limited by memory (some 5 kB each)
PLACES, UNCHANGED = 49, 5e-4  # number of places of a joint, and m, maximum variation of a constant distance
MAX_BOUND_ARRAY_SIZE = 2_000_000  # rows × pairs whose bounds are compared in one array


class CollisionModel:
    """Machine, tool, cutter, workpiece and obstacles of a cell, checked at joint positions.

    Joint positions x are (S, 6 + E): the joints of the arm in rad, then the external joints in rad or m in the order of
    the cell.
    ``cutting`` (S,) marks moves in which the cutter may touch the workpiece; entry n refers to the move that
    ends in row n. In the other moves the cutter, reduced by 0.1 mm at radius and tip, must not touch the
    workpiece: a rapid move may start or end where the cutter just touches. ``clearance`` applies to every
    other pair.

    Args:
        cell: tool, workpiece, obstacles, T_world_base and external joints.
        robot: kinematics of the arm.
        shapes: the URDF's collision bodies, from :func:`machopt.kinematics.urdf_loading.load_chain`.
        clearance: m, required distance.
        still: the external joints are fixed at home, and x is (S, 6): the arm's joints alone.

    Attributes:
        pairs: checked pairs.
        excluded: unchecked pairs with the reason: contact by construction, or allowed by the cell.
        adjacent: adjacent links, which are not compared either.
        suspicious: messages about pairs in contact at the home pose (a model error or a too coarse mesh).

    Raises:
        InputError: a mesh cannot be read, or the external joints form no chain.
    """

    def __init__(
        self, cell: Cell, robot: Robot, shapes: tuple[LinkShape, ...], clearance: float, *, still: bool = False
    ) -> None:
        machine = load_machine(cell, robot)
        self._lines, self.clearance = MachineLines.build(cell, machine, still=still), clearance
        carriers = LinkCarriers(cell, machine)
        self._bodies = [*build_robot_bodies(carriers, shapes), *build_cell_bodies(cell, carriers)]
        candidates = [(i, j, False) for i, j in list_candidate_pairs(self._bodies)]
        if cell.tool.cutter is not None:
            cutter, drawn_in = (
                build_cutter_body(cell, machine, cell.tool.cutter, s) for s in (0.0, CONTACT_TOLERANCE_M)
            )
            for i, body in enumerate(self._bodies):
                if body.kind == "workpiece":
                    candidates.append((i, len(self._bodies) + 1, True))
                elif body.kind == "obstacle" or (body.kind == "link" and body.link <= machine.base_link + 5):
                    candidates.append((i, len(self._bodies), False))
            self._bodies += [cutter, drawn_in]
        by_cell = list_allowed_contacts(cell)
        exclusions = tuple(
            self._describe_exclusions(pair[:2], why)
            for pair in candidates
            if (why := by_cell.get(self._get_pair_names(*pair[:2]))) is not None
        )
        candidates = [pair for pair in candidates if self._get_pair_names(*pair[:2]) not in by_cell]
        self.adjacent: tuple[ExcludedCollisionPair, ...] = tuple(
            self._describe_exclusions(pair, "adjacent: one hangs on the other")
            for pair in list_adjacent_pairs(self._bodies)
        )
        self.surfaces = FclSurfaces(self._bodies)
        self.outlines = map_in_threads(build_outline, self._bodies)
        self._take([(i, j) for i, j, _ in candidates], [touch for *_, touch in candidates])
        self.excluded: tuple[ExcludedCollisionPair, ...] = (*self._exclude(candidates), *exclusions)
        self._told_nothing = self._find_constant_pairs()
        at_home = self._check_pairs(np.append(cell.home, cell.external_home)[None, : self._lines.columns])
        self.suspicious: tuple[str, ...] = tuple(
            f"{p.name} touch or are nearer than the clearance at the home pose{suggest_remedy(p)}"
            for p, hit in zip(self.pairs, at_home[0], strict=True)
            if hit
        )

    def copy_unused(self) -> CollisionModel:
        """Return a model of the same bodies and pairs that has measured no distance yet."""
        model = copy(self)
        model.surfaces, model._memory = FclSurfaces(self._bodies), model._build_memory()
        return model

    @property
    def bodies(self) -> tuple[CollisionBody, ...]:
        """Checked bodies; a cutter occurs twice, the second time reduced."""
        return tuple(self._bodies)

    def check_configurations(self, q: Array, cutting: Bools) -> CollisionContacts:
        """Return which rows collide or are nearer than the clearance; each row by itself.

        Args:
            q: (S, 6 + E) rad or m, fastest where neighbouring rows are neighbouring poses.
            cutting: (S,) the cutter may touch the workpiece.
        """
        rows = MotionRows(self.stack, self._lines.compute_line_positions(q))
        contacts = build_no_contacts(len(rows.q))
        near = rows.bound < self._required
        near[cutting] &= ~self._spared
        for p in np.flatnonzero(near.any(axis=0)).tolist():
            undecided = np.flatnonzero(near[:, p] & ~contacts.hit)
            hit = (
                undecided[self._is_near(p, rows.compute_relative_motion(p)[undecided])] if len(undecided) else undecided
            )
            contacts.hit[hit], contacts.pair[hit], contacts.row[hit] = True, p, hit
        return contacts

    def check_motion(
        self, q: Array, cutting: Bools, step: float, *, first_only: bool = False, starts: Bools | None = None
    ) -> CollisionContacts:
        """Check rows like :meth:`check_configurations`, and the motion from each to the next, linear in joint space.

        Row n refers to the motion from row n − 1 to row n and to row n itself. A contact shallower than half of
        0.1 mm between rows may be missed; nothing deeper.

        Args:
            q: (S, 6 + E) rad or m.
            cutting: (S,) the cutter may touch the workpiece in the move to the row.
            step: rad, greatest joint step at which the bounds are renewed (0.1 rad at most is used); for a sliding
                joint the displacement equivalent to the motion of a body by such a rotation.
            first_only: stop at the first pair that hits (for planners that only need yes or no).
            starts: (S,) the row begins another motion: the row itself is checked, not the way to it; None: the first.
        """
        q = self._lines.compute_line_positions(q)
        starts = np.zeros(len(q), bool) if starts is None else starts
        dense, owner, at = refine_motion(q, min(step, MAX_BOUNDED_STEP_RAD), self.stack.scale, starts)
        contacts = build_no_contacts(len(q))
        for start in range(0, len(dense), MAX_BLOCK_ROWS):  # a block starts at the last row of the previous one
            some = slice(max(start - 1, 0), start + MAX_BLOCK_ROWS)
            self._check_dense_rows(dense[some], (cutting, starts), owner[some], at[some], contacts, first_only)
            if first_only and contacts.any:
                break
        return contacts

    def _check_dense_rows(
        self,
        dense: Array,
        flags: tuple[Bools, Bools],
        owner: NDArray[np.int64],
        at: Array,
        contacts: CollisionContacts,
        first_only: bool,
    ) -> None:
        """Fill in the contacts of some dense rows (D, n); owner, at (D,) as :func:`refine_motion` returns them.

        Flags are ``cutting`` and ``starts`` of :meth:`check_motion`. No dense row lies on the way to a start.
        """
        cutting, starts = (flag[owner] for flag in flags)
        rows = MotionRows(self.stack, dense)
        for p, doubt in self._find_unproven_pairs(rows, cutting, starts):
            walk = self._check_pair_motion(rows, p, starts)
            open_rows = walk.select_unproven(np.flatnonzero(doubt))
            ways, k = walk.list_ways(open_rows), -1
            while (k := walk.skip_proven(ways, k)) < len(ways):
                n = owner[open_rows[k]]
                if contacts.hit[n]:
                    continue
                where = walk.find_first_contact(int(open_rows[k]))
                if not np.isnan(where):
                    low = int(np.floor(where))
                    place = at[low] + (where - low) * (at[min(low + 1, len(at) - 1)] - at[low])
                    contacts.hit[n], contacts.pair[n], contacts.row[n] = True, p, place
                    if first_only:
                        return

    def _check_pair_motion(self, rows: MotionRows, p: int, starts: Bools) -> PairMotionCheck:
        i, j = self.stack.index[p]
        meshes = self.outlines[i].mesh, self.outlines[j].mesh
        return PairMotionCheck(
            rows=rows,
            starts=starts,
            p=p,
            pair=(i, j),
            meshes=meshes,
            clearance=self.pairs[p].clearance,
            surfaces=self.surfaces,
            memory=self._memory[p],
        )

    def _find_unproven_pairs(self, rows: MotionRows, cutting: Bools, starts: Bools) -> Iterator[tuple[int, Bools]]:
        """Yield the pairs whose bounds do not prove every row and motion free, each with the undecided rows (M,)."""
        block = max(MAX_BOUND_ARRAY_SIZE // max(len(rows.q), 1), 1)
        for start in range(0, len(self.pairs), block):
            some = slice(start, start + block)
            margin = rows.bound[:, some] - self._required[some]
            checked = ~(cutting[:, None] & self._spared[some])
            doubt, near = margin < 0.0, margin[1:] + margin[:-1] < rows.reach[:, None]
            doubt, near = doubt & checked, near & checked[1:] & ~starts[1:, None]
            for k in np.flatnonzero(doubt.any(axis=0) | near.any(axis=0)).tolist():
                ways = np.flatnonzero(near[:, k])
                if len(ways):
                    sums = margin[ways + 1, k] + margin[ways, k]
                    doubt[ways + 1, k] |= sums < rows.bound_motion(start + k)[ways]
                yield start + k, doubt[:, k]

    def find_nearest_pair(self, q: Array, cutting: Bools, cap: float = MAX_DISTANCE_M) -> NearestPairs:
        """Return the least distance over the pairs at each row, and its pair; 0 in contact.

        Pairs with a constant distance, like a carriage and its own bed, or the link before the flange and a round tool,
        are left out: they would hide the distances that a plan can change.

        Args:
            q: (S, 6 + E) rad or m, fastest where neighbouring rows are neighbouring poses.
            cutting: (S,) the cutter may touch the workpiece.
            cap: m, distances above it are not measured.
        """
        checked = ~(np.asarray(cutting, bool)[:, None] & self._spared) & ~self._told_nothing
        return find_nearest_pairs(
            self.stack,
            self.surfaces,
            [o.mesh for o in self.outlines],
            self._lines.compute_line_positions(q),
            checked,
            cap,
        )

    def _find_constant_pairs(self) -> Bools:
        """Return (P,) the pairs with only one joint between them and a constant distance.

        :func:`machopt.verification.motion.collision.clearance_column.list_varying_pairs` implements the same rule
        independently: the joint is placed at both ends of its range and at 1/48 steps in between. A pair is constant if
        it never touches, is always within the cap and varies by less than UNCHANGED. The places are fixed, because
        random ones would find an end stop in one program and miss it in the other.
        """
        lines, out = self._lines, np.zeros(len(self.pairs), bool)
        if lines.fixed_external_joints is not None:
            return out
        q = lines.compute_line_positions(np.linspace(lines.lower, lines.upper, PLACES))
        for p, (i, j) in enumerate(self.stack.links):
            if j - i == 1:
                out[p] = self._is_distance_constant(p, q[[0, -1]]) and self._is_distance_constant(
                    p, q
                )  # the ends decide most pairs at once
        return out

    def _is_distance_constant(self, p: int, q: Array) -> bool:
        """Return whether pair p has the same distance at each q (S, n), within the cap and without contact."""
        checked = np.broadcast_to(np.arange(len(self.pairs)) == p, (len(q), len(self.pairs)))
        found = find_nearest_pairs(self.stack, self.surfaces, [o.mesh for o in self.outlines], q, checked).distance
        return bool(found.min() > 0.0 and found.max() < MAX_DISTANCE_M and np.ptp(found) < UNCHANGED)

    def _get_pair_names(self, i: int, j: int) -> frozenset[str]:
        return frozenset((self._bodies[i].name, self._bodies[j].name))

    def _describe_exclusions(self, pair: tuple[int, int], reason: str) -> ExcludedCollisionPair:
        return ExcludedCollisionPair(self._bodies[pair[0]].name, self._bodies[pair[1]].name, reason, np.nan)

    def _take(self, indices: list[tuple[int, int]], touch: list[bool]) -> None:
        bodies = self._bodies
        self.pairs: tuple[CollisionPair, ...] = tuple(
            CollisionPair(a.name, b.name, (a.kind, b.kind), 0.0 if t else self.clearance, t)
            for (a, b), t in zip(((bodies[i], bodies[j]) for i, j in indices), touch, strict=True)
        )
        self._required = np.array([pair.clearance for pair in self.pairs])  # (P,) m
        self._spared = np.array(touch, bool)  # (P,) not checked in moves that cut
        self.stack = BodyPairs(self._lines, bodies, indices)
        self._memory = self._build_memory()

    def _build_memory(self) -> list[DistanceMemory | None]:
        return [
            DistanceMemory(self._lines, i, self._bodies[pair[1]]) if j - i <= 2 else None
            for pair, (i, j) in zip(self.stack.index, self.stack.links, strict=True)
        ]

    def _exclude(self, wanted: list[tuple[int, int, bool]]) -> tuple[ExcludedCollisionPair, ...]:
        """Remove pairs that touch by construction, found by sampling without a manual list, and return them."""
        lines, bodies = self._lines, self._bodies
        sampled = [
            n
            for n, (i, j, _) in enumerate(wanted)
            if bodies[i].kind == bodies[j].kind == "link"
            or {bodies[i].kind, bodies[j].kind} == {"link", "tool"}
            or ("link" in (bodies[i].kind, bodies[j].kind) and bodies[j].link - bodies[i].link == 1)
        ]
        rng = np.random.default_rng(0)  # the same poses for every run of a robot
        few = slice(0, lines.columns)
        q = lines.lower[few] + (lines.upper - lines.lower)[few] * rng.random((RANDOM_POSES, lines.columns))
        quick = self._check_pairs(q[: RANDOM_POSES // 10], sampled)[:, sampled].mean(axis=0)
        sampled = [n for n, share in zip(sampled, quick, strict=True) if share > TWO_APART_CONTACT_SHARE / 2]
        share = self._check_pairs(q, sampled).mean(axis=0)
        dropped: dict[int, str] = {}
        near = f"in touch or nearer than {1e3 * self.clearance:g} mm in {{:.0%}} of {RANDOM_POSES} random poses"
        two_apart = [n for n in sampled if count_links_between(*(bodies[k] for k in wanted[n][:2])) == 2]
        some = [n for n in two_apart if TWO_APART_CONTACT_SHARE < share[n] <= ADJACENT_CONTACT_SHARE]
        if some:  # a large clearance does not indicate a coarse mesh: only true contact excludes a pair
            self._take([(i, j) for i, j, _ in wanted], [True] * len(wanted))
            share[some] = self._check_pairs(q, some)[:, some].mean(axis=0)
        for n in sampled:
            a, b = (bodies[k] for k in wanted[n][:2])
            of_one = (
                a.link >= lines.machine.world_link or b.link <= lines.machine.world_link
            )  # the positioner, or arm and rail
            if share[n] > ADJACENT_CONTACT_SHARE:
                dropped[n] = near.format(share[n])
            elif of_one and count_links_between(a, b) == 2 and share[n] > TWO_APART_CONTACT_SHARE:
                dropped[n] = (
                    f"links two apart with coarse meshes: in touch in {share[n]:.0%} of {RANDOM_POSES} random poses"
                )
        out = tuple(
            ExcludedCollisionPair(bodies[wanted[n][0]].name, bodies[wanted[n][1]].name, reason, float(share[n]))
            for n, reason in dropped.items()
        )
        remaining = [pair for n, pair in enumerate(wanted) if n not in dropped]
        self._take([(i, j) for i, j, _ in remaining], [touch for *_, touch in remaining])
        return out

    def check_single_pairs(self, q: Array, pair: NDArray[np.integer[Any]]) -> Bools:
        """Return whether one given pair per row touches or is nearer than its clearance; no other pair is checked.

        Much faster than :meth:`check_configurations` where most pairs do.

        Args:
            q: (S, 6 + E) rad or m.
            pair: (S,) index into ``pairs``.
        """
        out, q = np.zeros(len(q), bool), self._lines.compute_line_positions(q)
        for p in np.unique(pair).tolist():
            rows = np.flatnonzero(pair == p)
            i, j = self.stack.links[p]
            is_scattered = np.abs(np.diff(q[rows, i:j], axis=0)).sum() > SORTING_STRIP_RAD * len(rows)
            if (
                j - i <= 2 and is_scattered
            ):  # with two joints in between, neighbours in these are neighbouring placements
                rows = rows[np.lexsort((q[rows, j - 1], np.round(q[rows, i] / SORTING_STRIP_RAD)))]
            out[rows] = self._is_near(p, self.stack.compute_relative_motion(p, q[rows]))
        return out

    def _is_near(self, p: int, T: Array) -> Bools:
        """(S,) pair p touches or is nearer than its clearance, with its second body moved by T (S, 4, 4)."""
        i, j = self.stack.index[p]
        out = is_nearer_than(self.outlines[i], self.outlines[j], T, self.pairs[p].clearance)
        free = np.flatnonzero(~out)
        out[free] = self.surfaces.find_contained((i, j), T[free])
        return out

    def _check_pairs(self, q: Array, pair_indices: list[int] | None = None) -> Bools:
        """(S, P) in contact or nearer than the clearance, each row by itself."""
        rows = MotionRows(self.stack, self._lines.compute_line_positions(q))
        out = np.zeros(rows.bound.shape, bool)
        for p in range(len(self.pairs)) if pair_indices is None else pair_indices:
            n = np.flatnonzero(rows.bound[:, p] < self.pairs[p].clearance)
            out[n, p] = self._is_near(p, rows.compute_relative_motion(p)[n])
        return out
