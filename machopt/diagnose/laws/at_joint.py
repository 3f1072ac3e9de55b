"""Effects that twist a joint by its torque, as resting readings see them: each law of the registry, lifted to the TCP.

τ is the torque that a law follows: of a curve over the whole torque with weight, of others that of the load. A reading
of a load test counts φ(with load) − φ(without), a measured pose φ as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.history import history
from machopt.diagnose.nouns.problem import Curve, Hypothesis, Quantity, Shape
from machopt.diagnose.nouns.readings import Readings
from machopt.diagnose.search.finer import beside_each_other
from machopt.domain.location import joint_at, joints_of
from machopt.domain.stiffness import Term
from machopt.effects import files, registry
from machopt.effects.by_angle import ByAngle
from machopt.effects.given import Parameters
from machopt.effects.protocol import ARCMIN, MEMORIES, Drive, Effect, Law, Scale, timed

LEAST_SOFT = 1e-9  # rad/(N·m), that sizes in percent are of
WRIST = 3  # its first joint, 0-based
AT_ONCE = ("cycle", "approach")  # forgotten between two cycles, which nothing is that fades by the clock
FINE = 60  # points of a loop's branch, for the picture; angles of a range that are looked at


def hypotheses(r: Readings, j: int, effect: Effect) -> tuple[list[Hypothesis], str]:
    """The laws of an effect at joint j (0-based), or why these readings cannot show any."""
    out, reasons = [], []
    for law in effect.laws:
        if timed(law) and r.recording.time is None:
            reasons.append("the recording has no time_s")
            continue
        scale = scale_of(r, j, law)
        reason = law.silent(r.torque[:, j], r.weight_torque[:, j] if r.differences else np.zeros(len(r)), scale)
        if reason and r.differences:
            reasons.append(reason)
            continue
        grid = law.grid(scale)
        if grid:
            out.append(_hypothesis(r, j, effect, law, scale, grid))
    return out, "" if out or not reasons else reasons[0]


def scale_of(r: Readings, j: int, law: Law) -> Scale:
    """What shares and sizes of a law at joint j are of."""
    rare = calibrated.RESTING.rare
    low, high = np.quantile(r.state.q[:, j], (rare, 1.0 - rare))
    torque = r.torque[:, j] if law.weighs or not r.differences else r.load_torque[:, j]
    # beside a law of its angle a spring is what that law leaves of the joint, which may be nothing: its share is of all
    soft = r.alone if r.alone is not None and isinstance(law, ByAngle) else r.compliance
    return Scale(reach=_largest(torque), compliance=max(float(soft[j]), LEAST_SOFT), low=float(low), high=float(high))


def _hypothesis(r: Readings, j: int, effect: Effect, law: Law, scale: Scale, grid: tuple[Shape, ...]) -> Hypothesis:
    where = joint_at(j + 1)
    own = len(law.shape) and len(grid[0])  # numbers of a shape; what a gear remembers follows as its place in MEMORIES

    def memory(shape: Shape) -> str:
        return MEMORIES[int(shape[own])] if law.remembers else ""

    def columns(shape: Shape) -> Array:
        return r.lift(j, twist(r, j, law, np.array(shape[:own]), memory(shape)))

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape[:own]), scale)

    def term(x: Array, shape: Shape) -> Term:
        return Term(effect.name, where, files.write(law, x, np.array(shape[:own]), memory(shape)))

    def curve(x: Array, shape: Shape) -> Curve:
        at = np.array(shape[:own])
        return _loop(r, j, law, at, x, memory(shape), scale) if law.remembers else _line(r, j, law, at, x)

    def buildable(x: Array, shape: Shape) -> bool:
        return not (r.differences and isinstance(law, ByAngle)) or _bears_everywhere(
            law, x, np.array(shape[:own]), scale
        )

    if law.remembers:
        once = len(r.cycles) == len(np.unique(r.visit))  # every cycle is an arrival
        kept = [
            k for k, m in enumerate(MEMORIES) if not (timed(law) and m in AT_ONCE) and not (once and m == AT_ONCE[1])
        ]
        grid = tuple((*s, float(k)) for k in kept for s in grid)
    count = columns(grid[0]).shape[2]
    lower = tuple(least for _, _, least in files.named(law, count))
    return Hypothesis(
        effect=effect.name,
        location=where,
        law=law.name,
        equation=law.equation,
        columns=columns,
        quantities=sizes,
        shapes=grid,
        lower=lower if np.isfinite(lower).any() else (),
        correction=term,
        note=effect.note,
        family="joint",
        buildable=buildable,
        finer=None if law.remembers else beside_each_other(grid),
        curve=curve if law.weighs or (law.remembers and not timed(law)) else None,
    )


def _bears_everywhere(law: ByAngle, x: Array, shape: Array, scale: Scale) -> bool:
    """Whether a spring that changes with the angle gives way, not back, over the range, nowhere many times as much.

    Where a joint shows nearly nothing a law of its angle varies by any number of percent of that.
    """
    share = law.shares(shape, np.linspace(scale.low, scale.high, FINE)) @ x
    at = share - share.mean() + (scale.compliance or 0.0)  # about what the joint gives in the mean
    return bool(at.max() <= calibrated.RESTING.most_varied * at.min())


def pair(r: Readings, effect: Effect, where: str, note: str, equation: str = "") -> Hypothesis:
    """The law of an effect between two joints, each turned by the torque of the other."""
    law, (i, j) = effect.laws[0], joints_of(where)
    tau = r.load_torque if r.differences else r.torque
    scale = Scale(reach=_largest(tau[:, [i, j]]))

    def columns(shape: Shape) -> Array:
        by_j, by_i = (law.columns(np.array(shape), Drive(tau[:, k])) for k in (j, i))
        return r.lift(i, by_j) + r.lift(j, by_i)

    return Hypothesis(
        effect=effect.called,
        location=where,
        law=law.name,
        equation=equation or law.equation,
        columns=columns,
        quantities=lambda x, s: law.sizes(x, np.array(s), scale),
        shapes=law.grid(scale),
        correction=lambda x, s: Term(effect.called, where, files.write(law, x, np.array(s))),
        family="joint",
        note=note,
    )


def couplings(r: Readings) -> list[Hypothesis]:
    """Each of two joints turned by the torque of the other, in a load test."""
    note, said = (
        "out of what the joints' torques explain",
        "Δq_i = c_ij τ_j, Δq_j = c_ij τ_i (wrist gears on one shaft)",
    )
    return [pair(r, e, where, note, said) for e in registry.of_joint_pairs() for where in e.tried]


def couplings_at_rest(r: Readings) -> list[Hypothesis]:
    """The same in measured poses, where weight or load turns either: of the wrist, whose joints weight turns freely."""
    return [
        pair(r, e, where, "with the torque of the other joint", f"{e.laws[0].equation} under weight and load")
        for e in registry.of_joint_pairs()
        for where in e.tried
        if min(joints_of(where)) >= WRIST and np.abs(r.torque[:, joints_of(where)]).max() > 0.0
    ]


def lived_through(r: Readings, terms: Sequence[Term]) -> tuple[Array, tuple[Term, ...]]:
    """What terms of a stiffness file make of a load test whose gears remember as the terms say.

    Args:
        r: readings.
        terms: any; a term without ``memory`` is none of them, nor one by time where the recording has none.

    Returns:
        (N, 6) m, rad at the TCP, and the terms that are not in it.
    """
    moved, others = np.zeros((len(r), 6)), []
    single = {e.called: e for e in registry.of_joint_torque()}
    for term in terms:
        effect = single.get(term.effect)
        if effect is None or "memory" not in term.parameters:
            others.append(term)
            continue
        given = Parameters(term.parameters, term.effect)
        law = files.law_of(effect, given)
        values, shape, memory = files.read(law, given)
        if timed(law) and r.recording.time is None:
            others.append(term)
            continue
        j, _ = joints_of(term.location)
        moved += r.state.J[:, :, j] * (twist(r, j, law, shape, memory) @ values)[:, None]
    return moved, tuple(others)


def moved(r: Readings, term: Term) -> Array:
    """(N, D) m, rad, what a term of a joint, or between two, makes of measured poses; see held.at_rest."""
    effect = registry.elastic(term.effect)
    given = Parameters(term.parameters, term.effect)
    law = files.law_of(effect, given)
    values, shape, _ = files.read(law, given)
    i, j = joints_of(term.location)
    by_j, by_i = (law.columns(shape, Drive(r.torque[:, k], r.state.q[:, k])) @ values for k in (j, i))
    own, other = (r.seen(r.state.J[:, :, k] * by[:, None], k + 1) for k, by in ((i, by_j), (j, by_i)))
    return np.asarray(own + (other if effect.paired else 0.0))


def twist(r: Readings, j: int, law: Law, shape: Array, memory: str) -> Array:
    """(N, P) rad by which joint j turns per unit of each coefficient, as readings count it."""
    angle = r.state.q[:, j]
    if law.remembers:
        states = history(r, memory)
        return states.counted(law.columns(shape, states.drive(j, angle)), r.differences)
    if not r.differences:
        return law.columns(shape, Drive(r.torque[:, j], angle))
    if not law.weighs:
        return law.columns(shape, Drive(r.load_torque[:, j], angle))
    with_load, without = (law.columns(shape, Drive(tau, angle)) for tau in (r.torque[:, j], r.weight_torque[:, j]))
    return np.asarray(with_load - without)


def _line(r: Readings, j: int, law: Law, shape: Array, x: Array) -> Curve:
    """A law without memory over the torque."""
    tau = r.torque[:, j]
    span = float(np.abs(tau).max())
    at = np.linspace(-span, span, 2 * FINE + 1)
    line, each = (law.columns(shape, Drive(t, np.zeros_like(t))) @ x / ARCMIN for t in (at, tau))
    return Curve(
        x=at,
        law=line,
        x_label=f"torque at joint {j + 1} in N·m, weight included",
        y_label="twist in arcmin",
        data_x=tau,
        per_reading=each,
    )


def _loop(r: Readings, j: int, law: Law, shape: Array, x: Array, memory: str, scale: Scale) -> Curve:
    """A law with memory over one cycle up to the largest torque and back."""
    up = np.linspace(0.0, scale.reach, FINE)
    path = np.concatenate([up, up[::-1]])
    first = np.zeros(len(path), np.int64)
    first[0] = 1
    cycle = law.columns(shape, Drive(path, np.zeros_like(path), None, first)) @ x
    each = twist(r, j, law, shape, memory) @ x
    return Curve(
        x=path,
        law=cycle / ARCMIN,
        x_label=f"load torque at joint {j + 1} in N·m",
        y_label="twist in arcmin",
        data_x=r.load_torque[:, j],
        per_reading=each / ARCMIN,
    )


def _largest(tau: Array) -> float:
    return max(float(np.quantile(np.abs(tau), 1.0 - calibrated.RESTING.rare)), float(np.finfo(float).tiny))
