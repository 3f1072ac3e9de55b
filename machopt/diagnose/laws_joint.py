"""What a joint may do beside its linear spring: harden, click, lag, creep, change with its angle, pull its neighbour.

Each law is an extra twist of one joint, linear in its coefficients once its shape is fixed. τ is the torque that the
joint bears, weight included; a reading of a load test counts φ(with load) − φ(without).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from machopt.diagnose.problem import Curve, Hypothesis, Quantity, Shape
from machopt.diagnose.readings import Readings
from machopt.domain.stiffness import Term

Array = NDArray[np.float64]
ARCMIN = np.pi / 10800.0
CLICK = (0.01, 0.025, 0.06)  # threshold per largest torque: a step, softened
KNEE = (0.12, 0.2, 0.3, 0.45, 0.6)
PLAY = (0.03, 0.08, 0.15, 0.3, 0.5)
LEAST_SOFT = 1e-9  # rad/(N·m), that sizes in percent are of
CREEP = (3.0, 8.0, 20.0, 50.0, 120.0, 300.0)  # s
LEAST_RANGE = 0.02  # share of the largest load torque of all joints, scaled by lever: less drives nothing


def nonlinear(r: Readings, j: int) -> list[Hypothesis]:
    """Softer below a knee (lost motion, pin play that closes), or cubic hardening; odd in the torque."""
    largest, c = _largest(r.torque[:, j]), max(r.compliance[j], LEAST_SOFT)

    def knee(shape: Shape) -> Array:
        t = shape[0] * largest
        return r.lift(j, _counted(r, j, lambda tau: np.clip(tau, -t, t)))

    def knees(shape: Shape) -> Array:
        parts = []
        for t in (s * largest for s in shape):
            parts.append(np.clip(r.torque[:, j], -t, t))
            if r.differences:
                parts[-1] = parts[-1] - np.clip(r.weight_torque[:, j], -t, t)
        return r.lift(j, np.stack(parts, axis=1))

    def cubic(shape: Shape) -> Array:
        return r.lift(j, _counted(r, j, lambda tau: tau**3 / largest**2))

    def knee_size(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return {
            "stiffness_change": Quantity(100.0 * abs(x[0]) / c if c > 0 else np.inf, "%"),
            "knee_torque": Quantity(shape[0] * largest, "N·m"),
        }

    def cubic_size(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return {"stiffness_change": Quantity(300.0 * abs(x[0]) / c if c > 0 else np.inf, "%")}

    where = f"joint:{j + 1}"
    return [
        Hypothesis(
            "joint_nonlinear_stiffness", where, "two slopes",
            "φ = c τ + a clip(τ, ±τ₀): softer (a > 0) or harder below the knee τ₀; gear stiffness of RV and harmonic "
            "drives is catalogued so", knee, knee_size, tuple((s,) for s in KNEE), family="joint",
            correction=lambda x, s: Term("joint_nonlinear_stiffness", where, {
                "law": "knee", "extra_rad_per_Nm": float(x[0]), "knee_Nm": float(s[0] * largest)}),
            curve=_torque_curve(r, j, lambda tau, x, s: x[0] * np.clip(tau, -s[0] * largest, s[0] * largest)),
            note="the slope changes with the load",
        ),
        Hypothesis(
            "joint_nonlinear_stiffness", where, "three slopes", "φ = c τ + a clip(τ, ±τ₁) + b clip(τ, ±τ₂)", knees,
            lambda x, s: {"stiffness_change": Quantity(100.0 * abs(float(np.sum(x))) / c if c > 0 else np.inf, "%"),
                          "knee_torque": Quantity(s[0] * largest, "N·m")},
            ((0.06, 0.25), (0.1, 0.35), (0.15, 0.5), (0.25, 0.6)), family="joint",
            correction=lambda x, s: Term("joint_nonlinear_stiffness", where, {
                "law": "knees", "extra_rad_per_Nm": [float(v) for v in x],
                "knees_Nm": [float(v * largest) for v in s]}),
            curve=_torque_curve(r, j, lambda tau, x, s: x[0] * np.clip(tau, -s[0] * largest, s[0] * largest)
                                + x[1] * np.clip(tau, -s[1] * largest, s[1] * largest)),
            note="the slope changes with the load",
        ),
        Hypothesis(
            "joint_nonlinear_stiffness", where, "cubic", "φ = c τ + b τ³ (c(τ − βτ³), hardening for b < 0)",
            cubic, cubic_size, family="joint",
            correction=lambda x, s: Term("joint_nonlinear_stiffness", where, {
                "law": "cubic", "cubic_rad_per_Nm3": float(x[0] / largest**2)}),
            curve=_torque_curve(r, j, lambda tau, x, s: x[0] * tau**3 / largest**2),
            note="the slope changes with the load",
        ),
    ]  # fmt: skip


def backlash(r: Readings, j: int) -> list[Hypothesis]:
    """A step with the sign of the total torque; absent where weight keeps the teeth on one side."""
    tau, where = r.torque[:, j], f"joint:{j + 1}"
    largest = _largest(tau)
    crossing = (np.sign(tau) != np.sign(r.weight_torque[:, j])) & (np.abs(tau) > CLICK[0] * largest)
    if r.differences and crossing.sum() < 3 and np.abs(r.weight_torque[:, j]).min() > CLICK[-1] * largest:
        return []  # the torque never changes its sign: nothing clicks

    def step(shape: Shape) -> Array:
        t = shape[0] * largest
        return r.lift(j, _counted(r, j, lambda tau: 0.5 * np.clip(tau / t, -1.0, 1.0)))

    return [
        Hypothesis(
            "joint_backlash", where, "step with the sign of the total torque",
            "φ = c τ + ½ w sgn(τ), τ with weight; sgn rounded below a few percent of the largest torque", step,
            lambda x, s: {"width": Quantity(x[0] / ARCMIN, "arcmin")}, tuple((s,) for s in CLICK), (0.0,),
            correction=lambda x, s: Term("joint_backlash", where, {
                "width_arcmin": float(x[0] / ARCMIN), "transition_Nm": float(s[0] * largest)}),
            family="joint", note="where the torque changes its sign",
            curve=_torque_curve(r, j, lambda tau, x, s: 0.5 * x[0] * np.clip(tau / (s[0] * largest), -1.0, 1.0)),
        )
    ]  # fmt: skip


def hysteresis(r: Readings, j: int) -> list[Hypothesis]:
    """Play operators on the joint's load torque, in the order of the record (Prandtl–Ishlinskii)."""
    largest, where = _largest(r.load_torque[:, j]), f"joint:{j + 1}"

    def one(shape: Shape) -> Array:
        return r.lift(j, play(r, j, shape[0], int(shape[1])))

    def two(shape: Shape) -> Array:
        parts = [play(r, j, s, int(shape[2])) for s in shape[:2]]
        return r.lift(j, np.stack(parts, axis=1))

    def law(x: Array, shape: Shape, thresholds: tuple[float, ...]) -> Curve:
        parts = [play(r, j, s, int(shape[-1])) for s in thresholds]
        size = sum(float(a) * p for a, p in zip(x, parts, strict=True))
        up = np.linspace(0.0, largest, 60)
        path = np.concatenate([up, up[::-1]])
        twist = np.zeros_like(path)
        for a, s in zip(x, thresholds, strict=True):
            twist += a * _play_path(path, s * largest)
        return Curve(
            path, twist / ARCMIN, f"load torque at joint {j + 1} in N·m", "twist in arcmin", r.load_torque[:, j],
            np.asarray(size) / ARCMIN,
        )  # fmt: skip

    def width(x: Array, thresholds: tuple[float, ...]) -> Mapping[str, Quantity]:
        # opening of the loop in the middle of a cycle up to the largest torque and back
        open_ = sum(2.0 * abs(a) * min(s, 0.5) * largest for a, s in zip(x, thresholds, strict=True))
        return {"width": Quantity(open_ / ARCMIN, "arcmin"), "threshold": Quantity(thresholds[0] * largest, "N·m")}

    def term(x: Array, thresholds: tuple[float, ...]) -> Term:
        return Term("joint_hysteresis", where, {
            "law": "play", "weights_rad_per_Nm": [float(v) for v in x],
            "thresholds_Nm": [float(s * largest) for s in thresholds]})  # fmt: skip

    equation = "φ = c τ + Σ a P_r[τ], P_r the play operator of half-width r (Prandtl–Ishlinskii); rate-independent"
    pairs = tuple(
        (a, b, k) for k in (0.0, 1.0, 2.0, 3.0) for a, b in ((0.03, 0.15), (0.03, 0.3), (0.08, 0.3), (0.15, 0.5))
    )
    return [
        Hypothesis(
            "joint_hysteresis", where, "play", equation, one, lambda x, s: width(x, s[:1]),
            tuple((s, k) for k in (0.0, 1.0, 2.0, 3.0) for s in PLAY), (0.0,), lambda x, s: term(x, s[:1]),
            note="on load reversal", family="joint", curve=lambda x, s: law(x, s, s[:1]),
        ),
        Hypothesis(
            "joint_hysteresis", where, "two plays", equation, two, lambda x, s: width(x, s[:2]), pairs, (0.0, 0.0),
            lambda x, s: term(x, s[:2]), note="on load reversal", family="joint", curve=lambda x, s: law(x, s, s[:2]),
        ),
    ]  # fmt: skip


def creep(r: Readings, j: int) -> list[Hypothesis]:
    """A part of the twist that comes late: τ_c ẋ + x = τ."""
    c, where = max(r.compliance[j], LEAST_SOFT), f"joint:{j + 1}"
    time = r.recording.time
    if time is None:
        return []

    def late(shape: Shape) -> Array:
        return r.lift(j, np.stack([relaxed(r, j, t, int(shape[-1])) for t in shape[:-1]], axis=1))

    two = ((3.0, 20.0), (3.0, 60.0), (8.0, 60.0), (8.0, 200.0))
    pairs = tuple((a, b, k) for k in (0.0, 1.0, 2.0, 3.0) for a, b in two)
    return [
        Hypothesis(
            "joint_creep", where, "two time constants", "T ẋ + x = κ c τ, two of them, beside c τ", late,
            lambda x, s: {"share": Quantity(100.0 * float(np.sum(x)) / c if c > 0 else np.inf, "%"),
                          "time_constant": Quantity(s[0], "s"), "slow_constant": Quantity(s[1], "s")},
            pairs, (0.0, 0.0),
            lambda x, s: Term("joint_creep", where, {
                "extra_rad_per_Nm": float(np.sum(x)), "time_constant_s": float(s[1] if x[1] > x[0] else s[0])}),
            note="while the load rests", family="joint",
        ),
        Hypothesis(
            "joint_creep", where, "one time constant", "T ẋ + x = κ c τ beside c τ (Kelvin–Voigt)", late,
            lambda x, s: {"share": Quantity(100.0 * x[0] / c if c > 0 else np.inf, "%"),
                          "time_constant": Quantity(s[0], "s")},
            tuple((t, k) for k in (0.0, 1.0, 2.0, 3.0) for t in CREEP), (0.0,),
            lambda x, s: Term("joint_creep", where, {"extra_rad_per_Nm": float(x[0]), "time_constant_s": s[0]}),
            note="while the load rests", family="joint",
        )
    ]  # fmt: skip


def pose_dependent(r: Readings, j: int) -> list[Hypothesis]:
    """A spring that changes with the joint's own angle: a harmonic, two, or a soft sector."""
    q, tau, c = (
        r.state.q[:, j],
        r.load_torque[:, j] if r.differences else r.torque[:, j],
        max(r.compliance[j], LEAST_SOFT),
    )
    where = f"joint:{j + 1}"
    low, high = np.quantile(q, [0.02, 0.98])
    if high - low < np.radians(15.0):
        return []

    def harmonics(orders: tuple[int, ...]) -> Array:
        waves = [f(n * q) for n in orders for f in (np.cos, np.sin)]
        return r.lift(j, np.stack([tau * w for w in waves], axis=1))

    def swing(x: Array, orders: tuple[int, ...]) -> Mapping[str, Quantity]:
        at = np.linspace(low, high, 60)
        waves = np.stack([f(n * at) for n in orders for f in (np.cos, np.sin)], axis=1) @ x
        half = 0.5 * float(np.ptp(waves))
        return {"variation": Quantity(100.0 * half / c if c > 0 else np.inf, "%")}

    def sector(shape: Shape) -> Array:
        return r.lift(j, tau * np.exp(-0.5 * ((q - shape[0]) / shape[1]) ** 2))

    def first(x: Array, s: Shape) -> Term:
        return Term("joint_pose_dependent_stiffness", where, {
            "cos_rad_per_Nm": float(x[0]), "sin_rad_per_Nm": float(x[1])})  # fmt: skip

    by_angle = "changes with the joint's angle"
    law = "c(q) = c + Σ (a_n cos nq + b_n sin nq)"
    centres = np.linspace(low, high, 7)
    widths = (0.12 * (high - low), 0.25 * (high - low))
    return [
        Hypothesis("joint_pose_dependent_stiffness", where, "one harmonic", law, lambda s: harmonics((1,)),
                   lambda x, s: swing(x, (1,)), correction=first, family="joint", note=by_angle),
        Hypothesis("joint_pose_dependent_stiffness", where, "soft sector", "c(q) = c + a exp(−½((q − q₀)/σ)²)", sector,
                   lambda x, s: {"variation": Quantity(50.0 * abs(x[0]) / c if c > 0 else np.inf, "%"),
                                 "centre": Quantity(float(np.degrees(s[0])), "deg"),
                                 "width": Quantity(float(np.degrees(s[1])), "deg")},
                   tuple((float(a), float(w)) for a in centres for w in widths),
                   correction=lambda x, s: Term("joint_pose_dependent_stiffness", where, {
                       "law": "sector", "extra_rad_per_Nm": float(x[0]), "centre_deg": float(np.degrees(s[0])),
                       "width_deg": float(np.degrees(s[1]))}),
                   family="joint", note=by_angle),
        Hypothesis("joint_pose_dependent_stiffness", where, "two harmonics", law, lambda s: harmonics((1, 2)),
                   lambda x, s: swing(x, (1, 2)), family="joint", note=by_angle,
                   correction=lambda x, s: Term("joint_pose_dependent_stiffness", where, {
                       "cos_rad_per_Nm": float(x[0]), "sin_rad_per_Nm": float(x[1]),
                       "cos2_rad_per_Nm": float(x[2]), "sin2_rad_per_Nm": float(x[3])})),
    ]  # fmt: skip


def play(r: Readings, j: int, share: float, memory: int) -> Array:
    """(N,) output of a play operator on the torque of a joint; a reading counts from the unloaded state of its cycle.

    Args:
        share: half-width per largest load torque of the joint.
        memory: 0: each cycle starts relaxed; 1: with what the cycle before left in the gear; 2: weight winds the gear
            up on arrival, from rest; 3: the same, from what the pose before left.
    """
    key = ("play", share, memory)
    if key not in r.memo:
        threshold = share * np.array([_largest(t) for t in r.load_torque.T])
        out, state, visit, session = np.zeros((len(r), 6)), np.zeros(6), -1, -1
        for rows in r.cycles:
            here, weight = int(r.visit[rows[0]]), r.weight_torque[rows[0]] if memory > 1 else np.zeros(6)
            arrived, same = here != visit, int(r.session[rows[0]]) == session
            if memory == 0 or (arrived and not (memory == 3 and same)):
                state = np.zeros(6)
            visit, session = here, int(r.session[rows[0]])
            state = np.clip(state, weight - threshold, weight + threshold)  # unloaded
            start, tau = state, r.load_torque[rows] + weight
            low, high = tau - threshold, tau + threshold
            for k, n in enumerate(rows):
                state = np.minimum(np.maximum(state, low[k]), high[k])
                out[n] = state - (start if r.differences else 0.0)
        r.memo[key] = out
    return np.asarray(r.memo[key][:, j])


def relaxed(r: Readings, j: int, constant: float, memory: int) -> Array:
    """(N,) N·m, torque of a joint seen through a first-order lag; loads change right after the last reading.

    A reading of a load test counts from the unloaded state of its cycle, which stands as long before the first reading
    as readings stand apart.

    Args:
        memory: 0: each cycle starts at rest; 1: what a cycle left goes on fading in the next one of the visit;
            2: weight creeps too, from the arrival at the pose on; 3: the same, with what earlier poses left.
    """
    key = ("relaxed", constant, memory)
    if key not in r.memo:
        time = r.recording.time
        assert time is not None  # creep asks for it
        out, x, visit, last, session = np.zeros((len(r), 6)), np.zeros(6), -1, np.nan, -1
        for rows in r.cycles:
            gaps = np.maximum(np.diff(time[rows]), 0.0)
            wait = float(np.median(gaps)) if len(gaps) else constant
            here, first = int(r.visit[rows[0]]), float(time[rows[0]])
            weight = r.weight_torque[rows[0]] if memory > 1 else np.zeros(6)
            arrived = here != visit
            if memory == 0 or (arrived and (memory < 3 or r.session[rows[0]] != session)):
                x = np.zeros(6)
            same = r.session[rows[0]] == session and np.isfinite(last)
            away = max(first - wait - last, 0.0) if same and (not arrived or memory > 1) else wait
            x = weight + (x - weight) * np.exp(-away / constant)
            visit, start, session = here, x, int(r.session[rows[0]])
            fade = np.exp(-np.concatenate([[wait], gaps]) / constant)
            tau = r.load_torque[rows] + weight
            for k, n in enumerate(rows):
                x = x * fade[k] + tau[k] * (1.0 - fade[k])
                out[n] = x - (start if r.differences else 0.0)
            last = float(time[rows[-1]])
        r.memo[key] = out
    return np.asarray(r.memo[key][:, j])


def _play_path(path: Array, threshold: float) -> Array:
    out, state = np.empty_like(path), 0.0
    for n, value in enumerate(path):
        state = min(max(state, value - threshold), value + threshold)
        out[n] = state
    return out


def _counted(r: Readings, j: int, law: Callable[[Array], Array]) -> Array:
    loaded = law(r.torque[:, j])
    return np.asarray(loaded - law(r.weight_torque[:, j]) if r.differences else loaded)


def _largest(tau: Array) -> float:
    return max(float(np.quantile(np.abs(tau), 0.98)), float(np.finfo(float).tiny))


def _torque_curve(r: Readings, j: int, law: Callable[[Array, Array, Shape], Array]) -> Callable[[Array, Shape], Curve]:
    def curve(x: Array, shape: Shape) -> Curve:
        tau = r.torque[:, j]
        span = float(np.abs(tau).max())
        at = np.linspace(-span, span, 121)
        return Curve(
            at, law(at, x, shape) / ARCMIN, f"torque at joint {j + 1} in N·m, weight included", "twist in arcmin", tau,
            law(tau, x, shape) / ARCMIN,
        )  # fmt: skip

    return curve
