"""What readings show beyond a stiffness file, in the mean, as part of the model: the ``shift`` of its ``discrepancy``.

A file whose springs leave their readings says by how much it is off in the mean (:mod:`machopt.model.suspects`,
:mod:`machopt.identify.discrepancy`). Counted in, that mean is one more part of the elasticity: a search scores with it,
a deflection is told with it, and the path is shifted against it. It is the sum of :class:`~machopt.model.suspects.
Suspects`' columns, folded into a few matrices so that a search can afford it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.arrays import Array
from machopt.domain.lacking import COS, COUPLING, JOINT, LOADED, SIN, TERM, part_of
from machopt.domain.stiffness import Discrepancy
from machopt.model.robot import ArmState, Masses, Robot
from machopt.model.suspects import BENDS, Suspects, place_of
from machopt.model.terms.base import LinearTerm, Under
from machopt.model.terms.body import cross

LEAST = 0.1  # of a compliance that stays, however stiff the readings say the arm is where none was taken


@dataclass(frozen=True, kw_only=True)
class Shift:
    """The twist that a discrepancy's mean adds to a model's."""

    joints: Array  # (6, 6) rad/(N·m), whatever the angles
    cosines: Array  # (6,) rad/(N·m) times the cosine of the joint's own angle
    sines: Array  # (6,)
    gears: tuple[tuple[int, float, float], ...]  # joint, N·m and rad of each tanh of its torque
    bodies: tuple[tuple[int, Array, Array], ...]  # body, place (3,) in base_link at q = 0, compliances (6,) in its axes
    rest: Suspects  # what has no matrix: the file's terms, and what weight and load do to posture
    by: Array  # (K,) of ``rest``

    @classmethod
    def of(
        cls,
        found: Discrepancy,
        robot: Robot,
        T_flange_tcp: Array,
        terms: tuple[LinearTerm, ...],
        masses: Masses | None,
        *,
        geometric: bool = False,
    ) -> Shift:
        """Args: terms: of the file, with their values; masses: None: weight counts as zero; geometric: see Suspects."""
        whole = Suspects(
            robot=robot,
            T_flange_tcp=T_flange_tcp,
            names=found.parts,
            torque=found.torque,
            terms=terms,
            masses=masses,
            geometric=geometric,
        )
        joints, cosines, sines = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
        gears: list[tuple[int, float, float]] = []
        bodies: dict[str, Array] = {}
        rest: dict[str, float] = {}
        for name, value in zip(found.parts, found.shift.tolist(), strict=True):
            part = part_of(name)
            word, numbers = part.kind, part.numbers
            if value == 0.0:
                continue
            if word == JOINT:
                joints[numbers[0], numbers[0]] += value
            elif word == COUPLING:
                i, j = numbers
                joints[i, j] += value
                joints[j, i] += value
            elif word in (COS, SIN):
                (cosines if word == COS else sines)[numbers[0]] += value
            elif word in BENDS:
                gears.append((numbers[0], float(BENDS[word] * found.torque[numbers[0]]), value))
            elif word in (TERM, LOADED):
                rest[name] = value
            else:
                bodies.setdefault(word, np.zeros(6))[part.axis] += value
        places = [(*place_of(robot, word), soft) for word, soft in bodies.items()]
        left = replace(whole, names=tuple(rest))
        return cls(
            joints=joints,
            cosines=cosines,
            sines=sines,
            gears=tuple(gears),
            bodies=tuple(places),
            rest=left,
            by=np.array([*rest.values()]),
        )

    @property
    def keeps(self) -> float | None:
        """What readings show may lie beyond what the springs have."""
        return LEAST

    def twist(self, under: Under, wrench: Array, *, small: bool) -> Array:
        """(M, 6) m and rad under wrenches (M, 6) at the TCP in base_link axes.

        Args:
            under: the gears' own stiffness, and where the arm stands; weight is that of all masses that are known.
            small: the tangent under weight, as for a load that is next to nothing.
        """
        state, k = under.state, under.gears
        J, q = state.J, state.q
        load = np.einsum("mci,mc->mi", J, wrench)
        turn = load @ self.joints + (np.cos(q) * self.cosines + np.sin(q) * self.sines) * load
        weight = self.rest.weight(state) if self.gears or len(self.by) else np.zeros_like(load)
        if self.gears:
            for j, scale, size in self.gears:
                before = np.tanh(weight[:, j] / scale)
                if small:
                    turn[:, j] += size * (1.0 - before**2) / scale * load[:, j]
                else:
                    turn[:, j] += size * (np.tanh((weight[:, j] + load[:, j]) / scale) - before)
        out = np.einsum("mci,mi->mc", J, turn)
        for body, at, soft in self.bodies:
            out += _given(state, body, at, soft, wrench)
        if len(self.by):
            out += (
                self.rest.response(state, np.broadcast_to(k, load.shape), wrench, small=small, weight=weight) @ self.by
            )
        return np.asarray(out)


def _given(state: ArmState, body: int, at: Array, soft: Array, wrench: Array) -> Array:
    """(M, 6) twist of the TCP where a body gives way at one place."""
    assert state.R_bodies is not None
    assert state.p_bodies is not None
    R = state.R_bodies[:, body]
    r = state.T_base_tool[:, :3, 3] - state.p_bodies[:, body] - R @ at
    force, moment = wrench[:, :3], wrench[:, 3:] + cross(r, wrench[:, :3])
    shift, turn = (
        np.einsum("mij,mj->mi", R, c * np.einsum("mji,mj->mi", R, v))
        for c, v in ((soft[:3], force), (soft[3:], moment))
    )
    return np.concatenate([shift + cross(turn, r), turn], axis=1)
