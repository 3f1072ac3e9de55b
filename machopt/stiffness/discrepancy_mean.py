"""Mean model discrepancy of a stiffness file as part of the model: the ``shift`` of its ``discrepancy``.

A file whose springs do not explain its readings states its mean error
(:mod:`machopt.stiffness.discrepancy_columns`,
:mod:`machopt.measurement.identification.assessment.model_discrepancy`). If included, that mean is one more part of the
compliance: a search scores with it, a deflection is reported with it, and the path is compensated with it. It is the
sum of :class:`~machopt.stiffness.discrepancy_columns.DiscrepancyColumns`' columns, combined into a few matrices so that
a search is fast enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.discrepancy_names import COS, COUPLING, JOINT, LOADED, SIN, TERM, parse_discrepancy_name
from machopt.data_types.stiffness import ModelDiscrepancy
from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import cross_product
from machopt.stiffness.discrepancy_columns import CURVE_SMOOTHING, LOOP_COLUMN, DiscrepancyColumns, locate_compliance
from machopt.stiffness.terms.term_interface import LinearTerm, LoadedArm

MIN_RETAINED_SHARE = 0.1  # minimum remaining share of a compliance, because the extrapolated mean may be too stiff


@dataclass(frozen=True, kw_only=True)
class DiscrepancyMean:
    """Twist that the mean of a discrepancy adds to that of a model."""

    joints: Array  # (6, 6) rad/(N·m), independent of the angles
    cosines: Array  # (n,) rad/(N·m) times the cosine of the joint's own angle
    sines: Array  # (n,)
    gears: tuple[tuple[int, float, float], ...]  # joint, N·m and rad of each tanh of its torque
    bodies: tuple[tuple[int, Array, Array], ...]  # body, place (3,) in base_link at q = 0, compliances (6,) in its axes
    rest: DiscrepancyColumns  # columns without a matrix: the file's terms, and the effect of weight and load on posture
    coefficients: Array  # (K,) of ``rest``

    @classmethod
    def build(
        cls,
        model_discrepancy: ModelDiscrepancy,
        robot: Robot,
        T_flange_tcp: Array,
        terms: tuple[LinearTerm, ...],
        masses: RobotMasses | None,
        *,
        geometric: bool = False,
    ) -> DiscrepancyMean:
        """Combine the columns of a discrepancy.

        Args:
            model_discrepancy: discrepancy of the file.
            robot: kinematic model.
            T_flange_tcp: (4, 4) TCP relative to the flange.
            terms: terms of the file, with their values.
            masses: masses of links and tool; None: weight counts as zero.
            geometric: as in :class:`~machopt.stiffness.discrepancy_columns.DiscrepancyColumns`.
        """
        whole = DiscrepancyColumns(
            robot=robot,
            T_flange_tcp=T_flange_tcp,
            names=model_discrepancy.parts,
            torque=model_discrepancy.torque,
            terms=terms,
            masses=masses,
            geometric=geometric,
        )
        parts = _sort_shifts(model_discrepancy)
        return cls(
            joints=parts.joints,
            cosines=parts.cosines,
            sines=parts.sines,
            gears=tuple(parts.gears),
            bodies=tuple((*locate_compliance(robot, word), soft) for word, soft in parts.bodies.items()),
            rest=replace(whole, names=tuple(parts.rest)),
            coefficients=np.array([*parts.rest.values()]),
        )

    @property
    def retained_share(self) -> float | None:
        """Minimum share of the compliance that remains, because the mean may exceed the compliance of the springs."""
        return MIN_RETAINED_SHARE

    def compute_twist(self, under: LoadedArm, wrench: Array, *, small: bool) -> Array:
        """Return the (M, 6) twist in m and rad.

        Args:
            under: state of the arm with the gears' own stiffness; weight is that of all known masses.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            small: the tangent under weight, for an infinitesimal load.
        """
        state, k = under.state, under.gears
        J, q = state.J, state.q
        load = np.einsum("mci,mc->mi", J, wrench)
        turn = load @ self.joints + (np.cos(q) * self.cosines + np.sin(q) * self.sines) * load
        weight = self.rest.compute_weight_torque(state) if self.gears or len(self.coefficients) else np.zeros_like(load)
        if self.gears:
            for j, scale, size in self.gears:
                before = np.tanh(weight[:, j] / scale)
                if small:
                    turn[:, j] += size * (1.0 - before**2) / scale * load[:, j]
                else:
                    turn[:, j] += size * (np.tanh((weight[:, j] + load[:, j]) / scale) - before)
        out = np.einsum("mci,mi->mc", J, turn)
        for body, at, soft in self.bodies:
            out += _compute_body_twist(state, body, at, soft, wrench)
        if len(self.coefficients):
            out += (
                self.rest.compute_columns(state, np.broadcast_to(k, load.shape), wrench, small=small, weight=weight)
                @ self.coefficients
            )
        return np.asarray(out)


def _compute_body_twist(state: ArmState, body: int, at: Array, soft: Array, wrench: Array) -> Array:
    """Return the (M, 6) twist of the TCP for a body's compliance at one place."""
    assert state.R_bodies is not None
    assert state.p_bodies is not None
    R = state.R_bodies[:, body]
    r = state.T_base_tool[:, :3, 3] - state.p_bodies[:, body] - R @ at
    force, moment = wrench[:, :3], wrench[:, 3:] + cross_product(r, wrench[:, :3])
    shift, turn = (
        np.einsum("mij,mj->mi", R, c * np.einsum("mji,mj->mi", R, v))
        for c, v in ((soft[:3], force), (soft[3:], moment))
    )
    return np.concatenate([shift + cross_product(turn, r), turn], axis=1)


@dataclass(frozen=True, kw_only=True)
class _SortedShifts:
    """Mean values of a discrepancy by the kind of part, SI."""

    joints: Array  # (n, n) compliances of the joints and their couplings
    cosines: Array  # (n,) of the joint angle
    sines: Array  # (n,)
    gears: list[tuple[int, float, float]]  # joint, smoothing torque in N·m, value
    bodies: dict[str, Array]  # (6,) compliances of each body
    rest: dict[str, float]  # values of the columns that are not summed here


def _sort_shifts(model_discrepancy: ModelDiscrepancy) -> _SortedShifts:
    """Return the mean values of the parts of a discrepancy, each kind apart."""
    n = len(model_discrepancy.torque)
    joints, cosines, sines = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    gears: list[tuple[int, float, float]] = []
    bodies: dict[str, Array] = {}
    rest: dict[str, float] = {}
    for name, value in zip(model_discrepancy.parts, model_discrepancy.shift.tolist(), strict=True):
        part = parse_discrepancy_name(name)
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
        elif word in CURVE_SMOOTHING:
            gears.append((numbers[0], float(CURVE_SMOOTHING[word] * model_discrepancy.torque[numbers[0]]), value))
        elif word in (TERM, LOADED, LOOP_COLUMN):
            rest[name] = value
        else:
            bodies.setdefault(word, np.zeros(6))[part.axis] += value
    return _SortedShifts(joints=joints, cosines=cosines, sines=sines, gears=gears, bodies=bodies, rest=rest)
