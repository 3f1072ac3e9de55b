"""Forms that are no effect of the catalogue, tried so that no effect is reported in their place.

A law imitates whatever resembles it. If a displacement of the whole recording, in no joint and by no body stiffness,
predicts held-out poses better than every law, it is fitted, reported by its location, and never given an effect's
name. The forms are those of an inelastic interface, which slips, or moves by size and direction of the load alone.
Another form is an external constraint: a hose or cable to the hall pulls at all joints at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.effect_locations import format_link_location
from machopt.measurement.diagnosis.data_types.diagnosis_problem import UNCATALOGUED, EffectHypothesis, Quantity, Shape
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.estimation.reading_covariance import compute_joint_sensitivity
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]
SHARES: tuple[Shape, ...] = tuple((s,) for s in (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9))  # of the largest load
QUADRATIC_LAW = (0.0,)  # no threshold: proportional to the square of the load
SLIP_LAW, JUMP_LAW, FRICTION_LAW = "slips and stays", "moves by the load's direction", "holds some of the load back"
SETTLEMENT_LAW = "moves with the load in one session more than in another"
POWERS: tuple[Shape, ...] = ((1.0,), (2.0,))  # exponents of the load
MOST_DAYS = 4  # most sessions
PULL_LAW = "is pulled at from outside"
FOREARM = 4  # link at whose end a hose may pull, beside the flange


def build_interface_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the forms of inelastic interfaces at both ends of the chain.

    Args:
        r: Readings of a load test.

    Returns:
        The hypotheses.
    """
    force = r.wrench[:, :3]
    size = np.linalg.norm(force, axis=1)
    largest = float(size.max(initial=0.0))
    if largest <= 0.0:
        return []
    along = np.divide(force, size[:, None], out=np.zeros_like(force), where=size[:, None] > 0)
    share = size / largest
    tool = r.state.T_base_tool[:, :3, :3]
    base = np.broadcast_to(np.eye(3), tool.shape)
    cycle = np.unique(np.stack([r.visit, r.cycle], axis=1), axis=0, return_inverse=True)[1].reshape(-1)

    def wide(columns: Array) -> Array:
        """(N, D, p): an interface of which only the translation is known."""
        none = np.zeros((len(columns), r.dimensions - 3, columns.shape[2]))
        return np.concatenate([columns, none], axis=1)

    def slipped(shape: Shape) -> Array:
        return wide(_compute_slip_direction(along, share, cycle, shape[0])[:, :, None])

    def jumps(axes: Array) -> Callable[[Shape], Array]:
        local = np.einsum("nij,ni->nj", axes, along)

        def columns(shape: Shape) -> Array:
            how = share**2 if shape == QUADRATIC_LAW else (share > shape[0]).astype(float)
            return wide(np.einsum("nia,n,nb->niab", axes, how, local).reshape(len(local), 3, 9))

        return columns

    def rubs(shape: Shape) -> Array:
        return r.compute_displacement(r.wrench * _compute_load_direction(share, cycle)[:, None])[:, :, None]

    return [
        build_uncatalogued_hypothesis(
            "sensor:force",
            FRICTION_LAW,
            "takes a share of the load either way, as a jack or a pulley rubs",
            rubs,
            ((),),
        ),
        build_uncatalogued_hypothesis(
            "tool", SLIP_LAW, "slips along the load, from a share of it on, until the cycle ends", slipped, SHARES
        ),
        build_uncatalogued_hypothesis(
            "sensor:displacement", JUMP_LAW, _format_axes("base_link"), jumps(base), (QUADRATIC_LAW, *SHARES)
        ),
        build_uncatalogued_hypothesis(
            "tool", JUMP_LAW, _format_axes("the tool"), jumps(tool), (QUADRATIC_LAW, *SHARES)
        ),
        *(_build_pull_force(r, link) for link in (FOREARM, r.joint_count)),
        *_build_floor_settlement(share, r.session, wide),
    ]


def _build_floor_settlement(share: Array, session: Ints, wide: Callable[[Array], Array]) -> list[EffectHypothesis]:
    """Build a floor or stand that settles with the load in one direction, differently between sessions."""
    days = np.unique(session)
    if not 1 < len(days) <= MOST_DAYS:
        return []
    own = (session[:, None] == days[None, 1:]).astype(float)

    def columns(shape: Shape) -> Array:
        how = share ** shape[0]
        return wide(np.einsum("n,nd,ca->ncda", how, own, np.eye(3)).reshape(len(share), 3, -1))

    note = "moves one way with the load in one session and not, or less, in another, as on a soft floor"
    return [
        replace(
            build_uncatalogued_hypothesis("sensor:displacement", SETTLEMENT_LAW, note, columns, POWERS),
            varies_between_sessions=True,
        )
    ]


def _build_pull_force(r: StaticReadings, link: int) -> EffectHypothesis:
    """Build a hose or cable at the end of a link (1-based): f = f₀ − k (p − p̄), constant in base_link and position
    dependent.

    It acts with and without load, but the load changes its effect: the arm moves, f does not rotate with the joints,
    and its spring carries part of the load. To first order in f: ∂/∂q[J c Jᵀ w] c Eᵀ f + J c [(∂Eᵀ/∂q f) − k EᵀE] c
    Jᵀ w, E the Jacobian of that end.
    """
    assert r.state.R_bodies is not None  # readings come with bodies
    assert r.state.p_bodies is not None
    at = (
        r.state.R_bodies[:, link] @ r.robot.point[link] + r.state.p_bodies[:, link]
        if link < r.joint_count
        else _compute_flange_positions(r)
    )
    z = r.state.J[:, 3:, :link]
    # Jacobian of the link end: TCP motion minus rotation about the end
    end = r.state.J[:, :3, :link] - np.cross(z, (r.state.T_base_tool[:, :3, 3] - at)[:, :, None], axis=1)
    soft = r.compliance[:link]
    sensitivity = compute_joint_sensitivity(r.state.J, r.wrench, r.compliance)[:, : r.dimensions, :link]
    turned = soft * r.load_torque[:, :link]  # (N, link) by the load
    swept = np.empty((len(r), 3, link))  # Σ_b ∂E_a/∂q_b θ_b
    for a in range(link):
        each = [np.cross(z[:, :, min(a, b)], end[:, :, max(a, b)]) * turned[:, b, None] for b in range(link)]
        swept[:, :, a] = sum(each)
    own = np.einsum("nca,na->nc", end, turned)  # m, displacement of that end by the load

    def column(force: Array, borne: Array) -> Array:
        """(N, D, 1) of a force (N, 3) that is there and one (N, 3) that comes with the load."""
        there: Array = np.einsum("nda,a,nca,nc->nd", sensitivity, soft, end, force)
        twist = soft * (np.einsum("nca,nc->na", swept, force) + np.einsum("nca,nc->na", end, borne))
        moved: Array = sum(r.lift_joint_twist(a, twist[:, a]) for a in range(link))  # type: ignore[assignment]
        return there[:, :, None] + moved

    none, away = np.zeros_like(at), at - at.mean(axis=0)
    forces = [(np.broadcast_to(e, at.shape), none) for e in np.eye(3)]
    columns = np.concatenate([column(*f) for f in [*forces, (-away, -own)]], axis=2)
    note = "is pulled at from outside by a force that follows its place, as a hose or a cable to the hall pulls"
    form = build_uncatalogued_hypothesis(
        format_link_location(link) if link < r.joint_count else "tool", PULL_LAW, note, lambda shape: columns, ((),)
    )
    return replace(
        form, is_approximate=True
    )  # a cable may be slack in some poses, and its spring acts in one direction


def _compute_flange_positions(r: StaticReadings) -> Array:
    """Return the flange positions (N, 3) m in base_link."""
    back = -r.T_flange_tcp[:3, :3].T @ r.T_flange_tcp[:3, 3]
    return np.asarray(r.state.T_base_tool[:, :3, :3] @ back + r.state.T_base_tool[:, :3, 3])


def _format_axes(axes: str) -> str:
    return f"moves by which way the load points in axes of {axes} and how much it is, not as a spring does"


def build_uncatalogued_hypothesis(
    where: str, name: str, note: str, columns: Callable[[Shape], Array], shapes: tuple[Shape, ...]
) -> EffectHypothesis:
    """Build the hypothesis of an uncatalogued form.

    Args:
        where: Location.
        name: Name of the form.
        note: Where it is visible.
        columns: Function from a shape to columns (N, D, p).
        shapes: Grid of shapes.

    Returns:
        The hypothesis.
    """
    return EffectHypothesis(
        effect=UNCATALOGUED,
        location=where,
        law=name,
        equation="",
        columns=columns,
        quantities=_compute_size,
        shapes=shapes,
        family=UNCATALOGUED,
        note=note,
    )


def _compute_size(x: Array, shape: Shape) -> Mapping[str, Quantity]:
    return {"moves": Quantity(1e3 * float(np.linalg.norm(x)), "mm")}


def _compute_slip_direction(along: Array, share: Array, cycle: Ints, limit: float) -> Array:
    """Return the direction (N, 3) of the load that first exceeded the limit in a reading's cycle; zero before."""
    out = np.zeros_like(along)
    for label in np.unique(cycle):
        rows = np.flatnonzero(cycle == label)
        over = np.flatnonzero(share[rows] > limit)
        if len(over):
            out[rows[over[0] :]] = along[rows[over[0]]]
    return out


def _compute_load_direction(share: Array, cycle: Ints) -> Array:
    """Return −1 (N,) up to a cycle's largest load and +1 while it falls: friction reduces, then increases the
    response.
    """
    out = np.ones(len(share))
    for label in np.unique(cycle):
        rows = np.flatnonzero(cycle == label)
        out[rows[: int(share[rows].argmax()) + 1]] = -1.0
    return out


def describe_uncatalogued_forms(laws: list[EffectHypothesis]) -> tuple[str, ...]:
    """Describe selected uncatalogued forms.

    Args:
        laws: Their hypotheses.

    Returns:
        One sentence per form.
    """
    return tuple(
        f"something at {h.location} {h.note}: no effect of the catalogue is that, so nothing is named for it, and the "
        "extended model leaves it out"
        for h in laws
    )
