"""Where the arm stands without any load: zeros of the encoders, waves of the gears, wrist joints that drag each other.

Each is an extra angle Δ_j of one joint at encoder angles q, lifted by J_j; compensated in the exported joints.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.at_joint import pair
from machopt.diagnose.problem import Curve, Hypothesis, Shape
from machopt.diagnose.readings import Readings
from machopt.effects import coupling, kinematic, within
from machopt.effects.corrections import entry
from machopt.effects.protocol import DEGREE, Effect, joints_of
from machopt.effects.waves import ARCSEC

LOW_ORDERS = 12  # per turn of the joint: what turns with the output (rings, pins, bearings) comes round a few times
HIGH_ORDER = 200.0  # per turn: about the largest ratio of a robot's reducer, what turns with the motor
LOSS = 0.7  # rad, half the phase that neighbouring orders may part by at the ends of the range: 8 % of amplitude
MOST_HIGH = 48  # orders above the low ones
BALANCER = 3.0  # per turn of joint 2, the lowest order that is not a balancer's
WAVED = 3e-4  # rad, 1 sigma of a wave: a robot's gears run a minute of arc ahead and behind, strain wave gears more
DRAGGED = 1e-3  # 1 sigma of a coupling's ratio, of the size that wrists without compensation in the controller have
WRIST = ((4, 5), (4, 6), (5, 6))


def zero_offsets(r: Readings) -> list[Hypothesis]:
    """The encoder's zero is not the joint's: Δ_j = offset (mastering error)."""
    said = f"{kinematic.Constant.equation}, at the TCP J_j δ (Mooring, Roth & Driels 1991, Fundamentals of Manipulator "
    return [
        _unloaded(
            r,
            kinematic.ZERO,
            where,
            "constant angle",
            f"{said}Calibration)",
            note="without load, smooth over the poses",
        )
        for where in kinematic.ZERO.places
    ]


def transmission_errors(r: Readings) -> list[Hypothesis]:
    """Waves of a gear over its joint's angle: one order, or an order and its double."""
    out = []
    for j in range(6):
        orders = wave_orders(r, j)
        if not orders:
            continue
        out.append(_waves(r, j, "one wave", "Δ_j = a cos Nq_j + b sin Nq_j", tuple((n,) for n in orders), 0.0))
        double = tuple((n, 2.0 * n) for n in orders if 2.0 * n <= orders[-1])
        if double:
            out.append(
                _waves(r, j, "a wave and its double", "Δ_j = Σ_{n = N, 2N} a_n cos nq_j + b_n sin nq_j", double, 2.0)
            )
    return out


def wave_orders(r: Readings, j: int) -> tuple[float, ...]:
    """Orders per turn that these angles of joint j can show and tell apart.

    A balancer's torque on joint 2 has the first two orders: there these are offered as gravity_compensator alone.
    Whole orders up to LOW_ORDERS (parts that turn with the output). Above, a grid as fine as the range asks for, up
    to one order for every few distinct angles (``poses_per_order``): with fewer, some order among many fits any noise.
    """
    q = r.state.q[:, j]
    distinct = len(np.unique(np.round(q, 3)))  # poses that are returned to differ by less
    span = float(np.ptp(q))
    if span < calibrated.RESTING.least_wave or distinct < 8:
        return ()
    step = 2.0 * LOSS / (0.5 * span)
    first = max(
        1.0 if j != 1 else BALANCER, np.ceil(0.5 * np.pi / span)
    )  # a quarter of a wave is an offset and a slope
    low = np.arange(first, LOW_ORDERS + 0.5)
    budget = int(distinct / calibrated.RESTING.poses_per_order) - len(low)
    if budget > MOST_HIGH:  # whole orders of a joint that turns far: a finer grid only takes longer
        budget, step = MOST_HIGH, max(step, 1.0)
    high = LOW_ORDERS + step * np.arange(1, max(budget, 0) + 1)
    return tuple(float(n) for n in np.concatenate([low, high[high <= HIGH_ORDER]]))


def _waves(r: Readings, j: int, law: str, equation: str, shapes: tuple[Shape, ...], penalty: float) -> Hypothesis:
    q = r.state.q[:, j]

    def curve(x: Array, shape: Shape) -> Curve:
        at = np.linspace(q.min(), q.max(), 400)
        line, each = (kinematic.Waves().columns(np.array(shape), a) @ x / ARCSEC for a in (at, q))
        return Curve(at / DEGREE, line, f"joint {j + 1} in deg", "angle in arcsec", q / DEGREE, each)

    return _unloaded(
        r,
        kinematic.WAVES,
        f"joint:{j + 1}",
        law,
        f"{equation}, at the TCP J_j Δ_j (Whitney, Lozinski & Rourke 1986)",
        shapes,
        curve,
        penalty,
        "without load, periodic over the joint's angle",
        WAVED,
    )


def _unloaded(
    r: Readings,
    effect: Effect,
    where: str,
    law: str,
    equation: str,
    shapes: tuple[Shape, ...] = ((),),
    curve: Callable[[Array, Shape], Curve] | None = None,
    penalty: float = 0.0,
    note: str = "",
    held: float | None = None,
) -> Hypothesis:
    """A law of port angle, lifted to the TCP."""
    own, (by, moved) = effect.unloaded, joints_of(where)
    assert own is not None  # port angle
    q = r.state.q[:, by]
    over = {within.KEY: within.measured(q)} if effect is kinematic.WAVES else {}
    return Hypothesis(
        effect.called,
        where,
        law,
        equation,
        lambda s: r.lift(moved, own.columns(np.array(s), q)),
        lambda x, s: own.sizes(x, np.array(s)),
        shapes,
        correction=lambda x, s: entry(effect, where, x, np.array(s), over),
        family="kinematic",
        note=note,
        curve=curve,
        penalty=penalty,
        held=held,
    )


def couplings(r: Readings) -> list[Hypothesis]:
    """A wrist joint drags the next one, through the gears (Δ_j = κ q_i) or under torque (Δ_j = c_ij τ_i)."""
    out = []
    for i, j in WRIST:
        where = f"joint:{i}-{j}"
        out.append(
            _unloaded(
                r,
                coupling.KINEMATIC,
                where,
                "gears drag the next joint",
                f"Δ_{j} = κ q_{i} (hollow wrist: the shaft of joint {j} runs through joint {i})",
                note=f"joint {j} without load, in proportion to joint {i}",
                held=DRAGGED,
            )
        )
        if np.abs(r.torque[:, [i - 1, j - 1]]).max() > 0.0:
            said = f"{coupling.Elastic.equation} under weight and load"
            out.append(pair(r, coupling.ELASTIC, where, "with the torque of the other joint", said))
    return out
