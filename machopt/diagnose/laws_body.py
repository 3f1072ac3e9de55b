"""Give beside the joints: links, base, tool, coupled gears; each through the very terms that stiffness.yaml holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from machopt.diagnose.at_joint import pair
from machopt.diagnose.laws_weight import beam, two_planes
from machopt.diagnose.problem import Hypothesis, Quantity, Shape
from machopt.diagnose.readings import Readings
from machopt.domain.stiffness import Term
from machopt.effects import registry
from machopt.errors import InputError
from machopt.model.terms import LinearTerm, term_of
from machopt.model.terms.body import beam_axes

Array = NDArray[np.float64]
COUPLED = ((2, 3), (4, 5), (4, 6), (5, 6), (1, 2), (3, 4))
NOTE = "out of what the joints' torques explain"
BEAMS = (1, 2, 3, 4, 5)  # link 6 and the tool are one body


def coupling(r: Readings) -> list[Hypothesis]:
    """Each of two joints turned by the torque of the other."""
    said = "Δq_i = c_ij τ_j, Δq_j = c_ij τ_i (wrist gears on one shaft)"
    return [pair(r, e, f"joint:{i}-{j}", NOTE, said) for e in registry.of_joint_pairs() for i, j in COUPLED]


def links(r: Readings) -> list[Hypothesis]:
    """Link as a beam: bends, twists (zhang2025 eq. 20; L³/3EI, L²/2EI, L/EI, L/GJ)."""
    out, bare = [], replace(r, masses=None)  # weight cancels in displacements under load
    for i in BEAMS:
        where = f"link:{i}"
        try:
            term = term_of("link_compliance", where, r.robot, r.T_flange_tcp)
        except InputError:  # the next joint is at the same place: no beam
            continue

        for which, law in (((0,), "bends"), ((1,), "twists"), ((0, 1), "bends and twists")):
            out.append(
                _linear(
                    r,
                    term,
                    which,
                    law,
                    "cantilever: L³/3EI, L²/2EI, L/EI, L/GJ at the link's end",
                    partial(_beam_sizes, which),
                    (0.0,) * len(which),
                    "body",
                )
            )
        out.append(two_planes(bare, i, beam(bare, i), NOTE))
    return out


def _beam_sizes(which: tuple[int, ...], x: Array) -> Mapping[str, Quantity]:
    units = ("1/EI", "1/GJ")
    return {units[k]: Quantity(abs(float(v)), "1/(N·m²)") for k, v in zip(which, x, strict=True)}


def base(r: Readings) -> list[Hypothesis]:
    """Pedestal and bolts: rotations of base_link under the overturning moment, and all six directions."""
    term = term_of("base_compliance", "base", r.robot, r.T_flange_tcp)

    def tilt(x: Array) -> Mapping[str, Quantity]:
        return {"tilt_compliance": Quantity(float(np.max(np.abs(x[:2]))), "rad/(N·m)")}

    def six(x: Array) -> Mapping[str, Quantity]:
        return {
            "tilt_compliance": Quantity(float(np.max(np.abs(x[3:5]))), "rad/(N·m)"),
            "translation": Quantity(float(np.max(np.abs(x[:3]))), "m/N"),
        }

    return [
        _linear(r, term, (3, 4), "tilts", "G₀ C₀ G₀ᵀ w, C₀ about x and y of base_link", tilt, (0.0,) * 2, "body"),
        _linear(
            r, term, tuple(range(6)), "gives way in six directions", "G₀ C₀ G₀ᵀ w, C₀ diagonal", six, (0.0,) * 6, "body"
        ),
    ]


def tool(r: Readings) -> list[Hypothesis]:
    """Tool, spindle, flange: a beam along the tool, or a spring at the TCP, constant in the tool frame."""
    out = []
    try:
        beam = term_of("tool_compliance", "tool", r.robot, r.T_flange_tcp)
    except InputError:
        beam = None
    if beam is not None and len(beam.coefficients) == 2:
        out.append(
            _linear(
                r,
                beam,
                (0,),
                "bends",
                "cantilever from the flange to the TCP",
                lambda x: {"1/EI": Quantity(abs(float(x[0])), "1/(N·m²)")},
                (0.0,),
                "body",
            )
        )
    spring = term_of("tool_compliance", "tool", r.robot, r.T_flange_tcp, form="diagonal")

    def sizes(x: Array) -> Mapping[str, Quantity]:
        return {"lateral_compliance": Quantity(1e6 * float(np.max(np.abs(x[:3]))), "µm/N")}

    each = tuple(range(6)) if r.dimensions == 6 else (0, 1, 2)
    out.append(
        _linear(
            r,
            spring,
            each,
            "spring at the tool",
            "R C Rᵀ w, C diagonal in tool axes",
            sizes,
            (0.0,) * len(each),
            "body",
        )
    )
    out += _round(r)
    out.append(_full(r))
    return out


def _round(r: Readings) -> list[Hypothesis]:
    """A body of revolution about the tool axis, or about the line from the flange to the TCP, seen from the TCP."""
    full = term_of("tool_compliance", "tool", r.robot, r.T_flange_tcp, form="full")
    names = [c.name for c in full.coefficients]
    local = np.eye(3)  # the term's own axes: x out of the tool
    flange, T = r.robot.T_base_flange_zero, r.robot.T_base_flange_zero @ r.T_flange_tcp
    line = T[:3, 3] - flange[:3, 3]
    out = []
    for law, x in (("round, bends and tilts", T[:3, 2]), ("bends about the line from flange to TCP", line)):
        length = float(np.linalg.norm(x))
        if length < 1e-3 or (law.startswith("bends") and abs(x @ T[:3, 2]) > 0.999 * length):
            continue
        turn = beam_axes(T[:3, 2]).T @ beam_axes(x / length) if law.startswith("bends") else local
        mix = np.stack([_in_axes(C, turn, names) for C in _revolved()], axis=1)

        def columns(shape: Shape, mix: Array = mix) -> Array:
            return r.elastic(full) @ mix

        def correction(x: Array, shape: Shape, mix: Array = mix) -> Term:
            return full.with_values(mix @ x).to_file()

        out.append(
            Hypothesis(
                "tool_compliance",
                "tool",
                law,
                "R C Rᵀ w at the TCP, C of a body of revolution",
                columns,
                lambda x, s: {
                    "lateral_compliance": Quantity(1e6 * abs(float(x[0])), "µm/N"),
                    "tilt_compliance": Quantity(abs(float(x[1])), "rad/(N·m)"),
                },
                lower=(0.0, 0.0, -np.inf),
                correction=correction,
                family="body",
                note="constant in the tool frame",
            )
        )
    return out


def _full(r: Readings) -> Hypothesis:
    """Any symmetric compliance at the TCP in tool axes; of what the loads and readings can show."""
    full = term_of("tool_compliance", "tool", r.robot, r.T_flange_tcp, form="full")
    turning = r.dimensions == 6 or bool(r.wrench[:, 3:].any())
    which = [k for k, c in enumerate(full.coefficients) if turning or "r" not in c.name]

    def correction(x: Array, shape: Shape) -> Term:
        values = np.zeros(len(full.coefficients))
        values[which] = x
        pairs = [(i, j) for i in range(6) for j in range(i, 6)]
        C = np.zeros((6, 6))
        for (i, j), v in zip(pairs, values, strict=True):
            C[i, j] = C[j, i] = v
        size = np.sqrt(np.maximum(np.diag(C), 1e-30))
        w, V = np.linalg.eigh(C / np.outer(size, size))  # noise may leave a direction that pushes back
        C = (V * np.maximum(w, 0.0)) @ V.T * np.outer(size, size)
        return full.with_values(np.array([C[i, j] for i, j in pairs])).to_file()

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        named = {full.coefficients[k].name: float(v) for k, v in zip(which, x, strict=True)}
        return {"lateral_compliance": Quantity(1e6 * max(abs(named[n]) for n in ("ty", "tz")), "µm/N")}

    return Hypothesis(
        "tool_compliance",
        "tool",
        "gives way in every direction",
        "R C Rᵀ w at the TCP, C symmetric",
        lambda s: r.elastic(full)[:, :, which],
        sizes,
        correction=correction,
        family="body",
        note="constant in the tool frame",
    )


def _revolved() -> tuple[Array, Array, Array]:
    """Lateral shift, tilt, and what couples them, of a body of revolution about x."""
    shift, tilt, both = (np.zeros((6, 6)) for _ in range(3))
    shift[1, 1] = shift[2, 2] = tilt[4, 4] = tilt[5, 5] = 1.0
    both[1, 5] = both[5, 1] = 1.0
    both[2, 4] = both[4, 2] = -1.0
    return shift, tilt, both


def _in_axes(C: Array, turn: Array, names: list[str]) -> Array:
    """Coefficients of the full matrix for C given in other axes."""
    G = np.kron(np.eye(2), turn)
    A = G @ C @ G.T
    rows = ("tx", "ty", "tz", "rx", "ry", "rz")
    pairs = [n.split("·") if "·" in n else [n, n] for n in names]
    return np.array([A[rows.index(i), rows.index(j)] for i, j in pairs])


def _linear(
    r: Readings,
    term: LinearTerm,
    which: tuple[int, ...],
    law: str,
    equation: str,
    sizes: Callable[[Array], Mapping[str, Quantity]],
    lower: tuple[float, ...],
    family: str,
) -> Hypothesis:
    def columns(shape: Shape) -> Array:
        return r.elastic(term)[:, :, list(which)]

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
        lower=lower,
        correction=correction,
        family=family,
        note=NOTE,
    )
