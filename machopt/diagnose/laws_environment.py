"""What acts on an arm from outside without being a load test: weight at the flange, the balancer, heat, the frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.problem import Curve, Hypothesis, Quantity, RecordCorrection, Shape
from machopt.diagnose.readings import Readings
from machopt.effects.compensator import EFFECT, HARMONIC, LINKAGE
from machopt.effects.protocol import Beside
from machopt.se3 import skew

Columns = Callable[[Shape], Array]
Drive = Callable[[Array, Shape], Array]
WARM = (600.0, 1800.0, 3600.0, 7200.0, 14400.0)  # s, time constants of arms: gear boxes in minutes, castings in hours
LEAST_WARM, MOST_WARM = 0.05, 3.0  # of the longest session: faster looks like a jump, slower like a straight line
LEAST_SPAN = 300.0  # s, of a session in which heat shows
STEEL = 11.5e-6  # 1/K, thermal expansion of steel and cast iron
FOREARM = (3, 4, 5, 6)  # bodies that one casting carries, and grow as one


def payload(r: Readings) -> list[Hypothesis]:
    """Another mass at the flange than the cell states, seen by how far the joints' springs give."""
    if r.masses is None:
        return []
    own = r.masses.body == 6
    flange = r.robot.T_base_flange_zero
    carried = float(r.masses.mass[own].sum())
    centre = r.masses.mass[own] @ r.masses.com[own] / carried if carried > 0.0 else flange[:3, 3]
    at = flange[:3, :3].T @ (centre - flange[:3, 3])  # (3,) m in flange
    weight = _flange_weight(r)  # (N, D, 4) per kg at the flange's origin, per kg·m along its axes
    cause = "J c Jᵀ w of the weight of Δm at the tool side, c as the base has it"

    def full(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return {
            "mass": Quantity(float(x[0]), "kg"),
            **{f"moment_{a}": Quantity(float(v), "kg·m") for a, v in zip("xyz", x[1:], strict=True)},
        }

    def shifted(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return {
            "shift": Quantity(1e3 * float(np.linalg.norm(x)) / carried, "mm"),
            **{f"moment_{a}": Quantity(float(v), "kg·m") for a, v in zip("xyz", x, strict=True)},
        }

    where, note = "tool", "with gravity: as the joints' compliance, but shaped by the flange's weight alone"
    out = [
        Hypothesis(
            "payload",
            where,
            "another mass at the stated centre",
            cause,
            lambda s: weight @ np.r_[1.0, at][:, None],
            lambda x, s: {"mass": Quantity(float(x[0]), "kg")},
            family="environment",
            note=note,
        ),
        Hypothesis(
            "payload",
            where,
            "another mass at another place",
            f"{cause}, with Δ(m·com)",
            lambda s: weight,
            full,
            family="environment",
            note=note,
        ),
    ]
    if carried > 0.0:
        out.append(
            Hypothesis(
                "payload",
                where,
                "the stated mass at another place",
                f"{cause}, Δm = 0",
                lambda s: weight[:, :, 1:],
                shifted,
                family="environment",
                note=note,
            )
        )
    return out


def _flange_weight(r: Readings) -> Array:
    assert r.masses is not None  # payload asks
    T = r.state.T_base_tool
    R = T[:, :3, :3] @ r.T_flange_tcp[:3, :3].T
    arm = -np.einsum("nij,j->ni", R, r.T_flange_tcp[:3, 3])  # flange as seen from the TCP
    g = np.broadcast_to(r.masses.gravity, arm.shape)
    zero = np.zeros_like(arm)
    parts = [np.concatenate([g, np.cross(arm, g)], axis=1)]
    parts += [np.concatenate([zero, np.cross(R[:, :, k], g)], axis=1) for k in range(3)]
    return np.stack([r.through(w) for w in parts], axis=2)


def compensator(r: Readings) -> list[Hypothesis]:
    """The balancer of joint 2: its torque bends the joint, whatever the load."""
    q, c = r.state.q[:, 1], float(r.compliance[1])
    if r.masses is None or c <= 0.0 or np.ptp(q) < np.radians(15.0):
        return []
    along = np.linspace(q.min(), q.max(), 90)

    out = []
    for own, equation, penalty in (
        (LINKAGE, "Δ₂ = c₂ τ, τ = −(F₀ + k s) ds/dq, s² = a² + L² + 2aL cos(α + q₂)", 4.0),
        (HARMONIC, "Δ₂ = c₂ (A cos q₂ + B sin q₂)", 0.0),
    ):

        def drive(at: Array, shape: Shape, own: Beside = own) -> Array:
            return own.torque(np.array(shape), at)

        def sizes(x: Array, shape: Shape, drive: Drive = drive) -> Mapping[str, Quantity]:
            return {"peak_torque": Quantity(float(np.abs(drive(along, shape) @ x).max()), "N·m")}

        def curve(x: Array, shape: Shape, drive: Drive = drive) -> Curve:
            return Curve(
                np.degrees(along),
                drive(along, shape) @ x,
                "joint 2 in deg",
                "torque in N·m",
                np.degrees(q),
                drive(q, shape) @ x,
            )

        out.append(
            Hypothesis(
                EFFECT.name,
                "joint:2",
                own.name,
                f"{equation} (Klimchik et al. arXiv 1311.6810)",
                lambda s, drive=drive: r.lift(1, c * drive(q, s)),  # type: ignore[misc]
                sizes,
                own.grid(),
                family="joint",
                note="joint 2 only, by its angle",
                penalty=penalty,
                curve=curve,
            )
        )
    return out


def thermal(r: Readings) -> list[Hypothesis]:
    """Castings grow and the stand creeps with temperature or with the time since a session began.

    A load test counts from the unloaded state of its cycle: it shows what has moved since.
    """
    grown, stand = _growth(r), _stand(r)
    out = []
    for driver in _drivers(r):
        patterns = [
            _Pattern("the arm grows", grown.sum(axis=2, keepdims=True), driver.least, 0.0, True),
            _Pattern("links grow each by itself", grown, driver.least, 0.0, True),
            _Pattern("the stand shifts and tilts", stand, -np.inf, 6.0, False),
        ]
        if r.differences:
            patterns.append(_Pattern("the stand shifts", stand[:, :, :3], -np.inf, 0.0, False))
        out += [_drifting(driver, pattern) for pattern in patterns]
    return out


@dataclass(frozen=True)
class _Pattern:
    """Which way heat moves the TCP."""

    words: str
    columns: Array  # (N, D, p)
    least: float  # of the coefficients
    penalty: float
    grows: bool  # a strain, of castings


def _drifting(driver: _Driver, pattern: _Pattern) -> Hypothesis:
    p = pattern.columns.shape[2]

    def lifted(shape: Shape) -> Array:
        return np.asarray(pattern.columns * driver.at(shape)[:, None, None])

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        moved = np.linalg.norm((lifted(shape) @ x)[:, :3], axis=1)
        size = {"drift": Quantity(1e3 * float(moved.max()), "mm")}
        if pattern.grows:
            warmed = float(np.abs(driver.at(shape)).max() * np.abs(x).max()) / STEEL
            size["rise"] = Quantity(warmed, "K")  # of castings, if they are of iron or steel
        return size | ({"time_constant": Quantity(shape[0], "s")} if shape else {})

    return Hypothesis(
        "thermal_drift",
        "environment",
        f"{pattern.words} {driver.words}",
        f"α L ΔT: {driver.equation}",
        lifted,
        sizes,
        driver.shapes,
        (pattern.least,) * p if np.isfinite(pattern.least) else (),
        family="environment",
        note="with time and temperature, whatever the pose and load",
        penalty=pattern.penalty,
    )


@dataclass(frozen=True)
class _Driver:
    """What heat may follow."""

    words: str
    equation: str
    at: Callable[[Shape], Array]  # (N,) dimensionless or K
    shapes: tuple[Shape, ...]
    least: float  # of the coefficients: castings grow when warmed


def _drivers(r: Readings) -> list[_Driver]:
    out = []
    temperature, time = r.recording.temperature, r.recording.time
    if temperature is not None and np.ptp(temperature) > 0.0 and not r.differences:  # unloaded states have none
        rise = temperature - temperature[r.order[0]]
        out.append(_Driver("with the temperature", "s = T − T at the start", lambda s: rise, ((),), 0.0))
    if time is None:
        return out
    since, zero = np.zeros(len(r)), _unloaded(r, time) if r.differences else None
    for label in np.unique(r.session):
        rows = r.session == label
        start = time[rows].min() if zero is None else zero[rows].min()
        since[rows] = time[rows] - start
        if zero is not None:
            zero[rows] -= start
    longest = float(since.max())

    def counted(law: Callable[[Array], Array]) -> Array:
        return np.asarray(law(since) - (0.0 if zero is None else law(zero)))

    constants = tuple((t,) for t in WARM if LEAST_WARM * longest <= t <= MOST_WARM * longest)
    if longest > LEAST_SPAN:
        if constants:
            out.append(
                _Driver(
                    "after the start of a session",
                    "s = 1 − exp(−t/T), t since the session began",
                    lambda s: counted(lambda t: -np.expm1(-t / s[0])),
                    constants,
                    0.0,
                )
            )
        out.append(
            _Driver(
                "evenly over a session",
                "s = t since the session began",
                lambda s: counted(lambda t: t / longest),
                ((),),
                -np.inf,
            )
        )
    return out


def _unloaded(r: Readings, time: Array) -> Array:
    """(N,) s, when the unloaded state of each reading's cycle stood: as long before the first as readings are apart."""
    gaps = np.concatenate([np.diff(time[rows]) for rows in r.cycles])
    usual = float(np.median(gaps)) if len(gaps) else 0.0
    out = np.zeros(len(r))
    for rows in r.cycles:
        own = np.diff(time[rows])
        out[rows] = time[rows[0]] - (float(np.median(own)) if len(own) else usual)
    return out


def _growth(r: Readings) -> Array:
    """(N, D, 3) m per unit strain of the carousel, the upper arm, the forearm with the wrist."""
    assert r.state.R_bodies is not None  # readings come with bodies
    R = r.state.R_bodies
    points = [*r.robot.point, r.robot.T_base_flange_zero[:3, 3]]
    parts = []
    for group in ((1,), (2,), FOREARM):
        moved = np.zeros((len(r), r.dimensions))
        for i in group:
            moved[:, :3] += R[:, i] @ (points[i] - points[i - 1])
        parts.append(moved)
    return np.stack(parts, axis=2)


def _stand(r: Readings) -> Array:
    """(N, D, 6) shift in m and turn in rad of the stand about the middle of the points."""
    p = r.state.T_base_tool[:, :3, 3]
    out = np.zeros((len(r), 6, 6))
    out[:] = np.eye(6)
    out[:, :3, 3:] = -skew(p - p.mean(axis=0))
    return out[:, : r.dimensions]


def frame(r: Readings) -> list[Hypothesis]:
    """Where the recording says that the tracker stands in base_link and it does not."""
    columns = _stand(r)

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return {
            "angle": Quantity(float(np.degrees(np.linalg.norm(x[3:]))), "deg"),
            "shift": Quantity(1e3 * float(np.linalg.norm(x[:3])), "mm"),
        }

    return [
        Hypothesis(
            "displacement_frame",
            "sensor:displacement",
            "the tracker's frame stands elsewhere",
            "p = T p_recorded, T a shift and a small turn about the middle of the points",
            lambda s: columns,
            sizes,
            correction=lambda x, s: RecordCorrection(
                "displacement_frame", "sensor:displacement", {k: v.value for k, v in sizes(x, s).items()}
            ),
            family="sensor",
            note="in the record, not in the robot",
        )
    ]
