"""Bodies that give under what they carry: links, base and tool under weight and recorded load.

A load test cancels weight; a measured pose does not. What hangs on the far side of a spring acts on it with the
resultant of its weights and the recorded load. A wrench on the far side may be stated anywhere there, so at the TCP:
f = Σ m g + f_load, m = Σ (p_b − p_TCP) × m g + m_load. A link's own weight is spread along it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from machopt.diagnose.problem import Hypothesis, Quantity, Shape
from machopt.diagnose.readings import Readings
from machopt.domain.stiffness import Term
from machopt.effects.bodies import LINK, TWO_PLANES, sections
from machopt.errors import InputError
from machopt.model.terms import LinearTerm, term_of

Array = NDArray[np.float64]
BEAMS = (1, 2, 3, 4, 5)  # link 6 and the tool are one body
LEAST_LENGTH = 1e-3  # m; joints nearer than this make no beam
NOTE = "under weight, out of what the joints' torques explain"
CANTILEVER = "cantilever under weight and load: L³/3EI, L²/2EI, L/EI, L/GJ (zhang2025 eq. 19)"


def weight_wrench(r: Readings, carried: NDArray[np.bool_]) -> Array:
    """(N, 6) N, N·m at the TCP in base axes, of the weight of the bodies (B,) ``carried``."""
    if r.masses is None or not carried.any():
        return np.zeros((len(r), 6))
    assert r.state.R_bodies is not None  # readings come with bodies
    assert r.state.p_bodies is not None
    body, mass = r.masses.body[carried], r.masses.mass[carried]
    at = np.einsum("nbij,bj->nbi", r.state.R_bodies[:, body], r.masses.com[carried]) + r.state.p_bodies[:, body]
    force = mass[:, None] * r.masses.gravity
    moment = np.cross(at - r.state.T_base_tool[:, None, :3, 3], force)
    total = np.broadcast_to(force.sum(axis=0), (len(r), 3))
    return np.concatenate([total, moment.sum(axis=1)], axis=1)


def bodies(r: Readings) -> list[Hypothesis]:
    """Links as beams, the base as a tilting plate, the tool as a beam, each under what it carries."""
    out = []
    for i in BEAMS:
        columns = beam(r, i)
        if not np.abs(columns).max() > 0.0:
            continue
        term = term_of("link_compliance", f"link:{i}", r.robot, r.T_flange_tcp)
        bends = columns[:, :, :2].sum(axis=2)
        for which, law, made in (
            ((0,), "bends", bends[:, :, None]),
            ((1,), "twists", columns[:, :, 2:]),
            ((0, 1), "bends and twists", np.stack([bends, columns[:, :, 2]], axis=2)),
        ):
            out.append(
                _hypothesis(
                    r,
                    term,
                    which,
                    law,
                    CANTILEVER,
                    lambda s, made=made: made,  # type: ignore[misc]
                    lambda x, which=which: _beam_sizes(x, which),  # type: ignore[misc]
                )
            )
        out.append(two_planes(r, i, columns))
    everything = np.ones(0 if r.masses is None else len(r.masses.body), bool)
    load = r.wrench + weight_wrench(r, everything)
    if not np.abs(load).max() > 0.0:
        return out
    base = term_of("base_compliance", "base", r.robot, r.T_flange_tcp)
    out.append(
        _hypothesis(
            r,
            base,
            (3, 4),
            "tilts",
            "G₀ C₀ G₀ᵀ w, C₀ about x and y of base_link, w weight and load",
            lambda s: base.response(r.state, load)[:, : r.dimensions, 3:5],
            lambda x: {"tilt_compliance": Quantity(float(np.max(np.abs(x))), "rad/(N·m)")},
        )
    )
    try:
        tool = term_of("tool_compliance", "tool", r.robot, r.T_flange_tcp)
    except InputError:
        return out
    if len(tool.coefficients) == 2:
        own = np.zeros(len(everything), bool)
        if r.masses is not None:
            own[:] = r.masses.body == 6
        bent = tool.response(r.state, r.wrench + weight_wrench(r, own))[:, : r.dimensions]
        out.append(
            _hypothesis(
                r,
                tool,
                (0,),
                "bends",
                "cantilever from the flange to the TCP under weight and load",
                lambda s: bent[:, :, :1],
                lambda x: _beam_sizes(x, (0,)),
            )
        )
    return out


def beam(r: Readings, i: int) -> Array:
    """Link i as a beam, (N, D, 3) per unit of 1/EI in the arm's plane, 1/EI across it, 1/GJ.

    One principal axis is the normal of the arm's plane, the axis of joint 2 with all joints at zero. The link's own
    weight is spread evenly from its root to twice as far as its centre of mass.

    Returns:
        zeros where the next joint leaves no length.
    """
    assert r.state.R_bodies is not None  # readings come with bodies
    assert r.state.p_bodies is not None
    start, end = r.robot.point[i - 1], r.robot.point[i]
    length = float(np.linalg.norm(end - start))
    if length < LEAST_LENGTH:
        return np.zeros((len(r), r.dimensions, 3))
    R, moved, tip = r.state.R_bodies[:, i], r.state.p_bodies[:, i], r.state.T_base_tool[:, :3, 3]
    axes = [R @ n for n in _principal(r, i)]
    beyond = r.wrench if r.masses is None else r.wrench + weight_wrench(r, r.masses.body > i)
    own = (
        []
        if r.masses is None
        else [
            (r.masses.mass[b] * r.masses.gravity, 2.0 * float((r.masses.com[b] - start) @ (end - start)) / length)
            for b in np.flatnonzero(r.masses.body == i)
        ]
    )
    return sections(axes, length, tip - (R @ start + moved), beyond, own)[:, : r.dimensions]


def _principal(r: Readings, i: int) -> tuple[Array, Array, Array]:
    """Normal of the arm's plane, the other principal axis, the link's own; base_link axes at q = 0."""
    a = r.robot.point[i] - r.robot.point[i - 1]
    a = a / np.linalg.norm(a)
    normal = r.robot.axis[1] - (r.robot.axis[1] @ a) * a
    if np.linalg.norm(normal) < 0.1:  # a link along the axis of joint 2 has no plane of its own: any will do
        normal = np.eye(3)[int(np.abs(a).argmin())] - a[int(np.abs(a).argmin())] * a
    normal = normal / np.linalg.norm(normal)
    return normal, np.cross(a, normal), a


def _beam_sizes(x: Array, which: tuple[int, ...]) -> Mapping[str, Quantity]:
    return {("1/EI", "1/GJ")[k]: Quantity(abs(float(v)), "1/(N·m²)") for k, v in zip(which, x, strict=True)}


def two_planes(r: Readings, i: int, columns: Array, note: str = NOTE) -> Hypothesis:
    """A box is stiffer one way than the other."""

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        names = ("1/EI in the arm's plane", "1/EI across it", "1/GJ")
        parts = {name: Quantity(float(v), "1/(N·m²)") for name, v in zip(names, x, strict=True)}
        return {"1/EI": Quantity(float(x[:2].max()), "1/(N·m²)"), **parts}

    def correction(x: Array, shape: Shape) -> Term:
        return Term(LINK.name, f"link:{i}", TWO_PLANES.stated(x, _principal(r, i)[0]))

    return Hypothesis(
        "link_compliance",
        f"link:{i}",
        "bends in two planes and twists",
        f"{CANTILEVER}, EI of each principal axis",
        lambda s: columns,
        sizes,
        lower=(0.0,) * 3,
        correction=correction,
        family="body",
        note=note,
    )


def _hypothesis(
    r: Readings,
    term: LinearTerm,
    which: tuple[int, ...],
    law: str,
    equation: str,
    columns: Callable[[Shape], Array],
    sizes: Callable[[Array], Mapping[str, Quantity]],
) -> Hypothesis:
    def correction(x: Array, shape: Shape) -> Term:
        full = np.zeros(len(term.coefficients))
        full[list(which)] = x
        return term.with_values(full).to_file()

    return Hypothesis(
        term.effect,
        term.location,
        law,
        equation,
        columns,
        lambda x, s: sizes(x),
        lower=(0.0,) * len(which),
        correction=correction,
        family="body",
        note=NOTE,
    )
