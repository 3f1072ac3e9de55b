"""What friction does beyond Coulomb and viscous, per joint: rival laws on the motor's torque.

The base has, for each joint, offset, Coulomb c z and viscous d q̇, with z the direction of motion after a short
breakaway path (:func:`machopt.effects.friction.presliding`). A Coulomb torque that differs with the direction
is an offset and a Coulomb torque; it is told from a load that the model lacks by nothing, so it stays in the base.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.optimize import minimize_scalar

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws.motion_frame import Scene, curve, joint_law
from machopt.diagnose.nouns.problem import Curve, Hypothesis, Quantity, Shape
from machopt.effects import files, registry
from machopt.effects.friction import presliding
from machopt.effects.protocol import Effect, FrictionLaw, Pace, Rubbing

Turn = tuple[float, float]
# how friction turns over at a reversal in the base: breakaway path in rad (m), or speed in rad/s (m/s) of a tanh
TURNS = (
    (0.0, 0.0),
    (2e-5, 0.0),
    (5e-5, 0.0),
    (1e-4, 0.0),
    (2e-4, 0.0),
    (5e-4, 0.0),
    (1e-3, 0.0),
    (0.0, 0.001),
    (0.0, 0.003),
    (0.0, 0.01),
    (0.0, 0.03),
    (0.0, 0.1),
    (0.0, 0.3),
)
STEPS = 10  # between two of these
WIDER = 1.6  # times, and as much less: how far off the turn-over of the base may be
SMOOTH, PATH = (0.0, 0.003), (5e-5, 0.0)  # of the other kind
AT_ONCE = TURNS[0]
WARM = (15.0, 60.0, 300.0)  # s


def direction(scene: Scene, joint: int, turn: Turn) -> Array:
    """(M,) −1 … 1, which way a joint's friction points."""
    return turned(scene, scene.motion.v[:, joint], turn)


def unsure(scene: Scene, joint: int, turn: Turn) -> list[Array]:
    """Columns (M,) that make up for a turn-over a little off, in its width and in its kind.

    Without them what a reversal leaves, where encoders step or a joint dwells, passes for a peak at low speed.
    """
    wider, narrower = ((WIDER * path, WIDER * speed) for path, speed in (turn, (t / WIDER**2 for t in turn)))
    z = direction(scene, joint, turn)
    off = [direction(scene, joint, PATH if turn[1] > 0.0 else SMOOTH) - z]
    if turn != TURNS[0]:
        off.insert(0, direction(scene, joint, wider) - direction(scene, joint, narrower))
    return [x for x in off if _in_several(scene, x)]


def _in_several(scene: Scene, x: Array) -> bool:
    """Whether a signal (M,) shows in more than one stretch: of a single reversal no other stretch tells the size."""
    m = scene.motion
    power = np.bincount(np.unique(m.group, return_inverse=True)[1], m.within(m.mean(x[:, None]))[:, 0] ** 2)
    return bool(power.sum() - power.max() > calibrated.DETECTION.without_best * power.sum())


def turned(scene: Scene, v: Array, turn: Turn) -> Array:
    """The same of a speed (M,) rad/s: after a breakaway path, which is late, or over a speed, which is not."""
    path, speed = turn
    if speed > 0:
        return np.asarray(np.tanh(v / speed))
    return presliding(v, 1.0 / scene.motion.rate, scene.first, path)


def breakaway(scene: Scene, joint: int, y: Array, beside: Array) -> Turn:
    """The turn-over that suits a joint's torque (N,) best, Coulomb, viscous and inertia beside.

    Friction that turns over a little faster or slower than the base has it leaves what looks like a peak at low speed,
    so the best of TURNS is refined between its neighbours. ``beside`` (N, p) is what else the torque may hold.
    """
    power = _left(scene, joint, y, beside)
    best, found = np.inf, TURNS[0]
    for turn in TURNS:
        left = power(turn)
        if left < calibrated.MOTION.turn_over * best:
            best, found = left, turn
    return min((found, *_refined(found, power)), key=power)


def _left(scene: Scene, joint: int, y: Array, beside: Array) -> Callable[[Turn], float]:
    """Squares that each turn-over leaves of a joint's torque (N,), all else of it refitted, ``beside`` too."""
    m = scene.motion
    own = m.within(m.mean(np.stack([np.ones(len(m.q)), m.v[:, joint], m.a[:, joint]], axis=1)))
    rest = np.concatenate([own, beside], axis=1)

    def power(turn: Turn) -> float:
        z = m.within(m.mean(direction(scene, joint, turn)[:, None]))
        return float(np.sum(rest_of(y, np.concatenate([rest, z], axis=1))[0] ** 2))

    return power


def gradual(scene: Scene, joint: int, turn: Turn, y: Array, beside: Array) -> str:
    """Words for friction that surely turns over gradually, as Coulomb's does not; empty where it may be his.

    What a joint passes between two samples about a reversal says nothing of how its friction turns over there.
    """
    path, speed = turn
    between = float(np.sqrt(np.mean(scene.motion.a[:, joint] ** 2))) / scene.motion.rate  # rad/s (m/s)
    if speed <= between and 2.0 * path <= between / scene.motion.rate:
        return ""
    power = _left(scene, joint, y, beside)
    if len(y) * np.log(power(AT_ONCE) / max(power(turn), 1e-300)) < calibrated.DETECTION.gain:
        return ""
    if scene.prismatic[joint]:
        over = f"{1e3 * speed:.2g} mm/s" if speed > 0.0 else f"a path of {1e3 * path:.2g} mm"
    else:
        over = f"{np.degrees(speed):.2g} deg/s" if speed > 0.0 else f"a path of {1e3 * path:.2g} mrad"
    return f"friction that turns over gradually, over {over},"


def _refined(turn: Turn, power: Callable[[Turn], float]) -> tuple[Turn, ...]:
    """The best turn-over near one of TURNS; none near friction that turns at once."""
    kind = 0 if turn[0] > 0.0 else 1
    if turn[kind] == 0.0:
        return ()
    grid = sorted(t[kind] for t in TURNS if t[kind] > 0.0)
    n = grid.index(turn[kind])
    least, most = grid[n - 1] if n else grid[n] / 4.0, grid[n + 1] if n + 1 < len(grid) else 3.0 * grid[n]
    ends = np.log([least, most])

    def made(log: float) -> Turn:
        size = float(np.exp(log))
        return (size, 0.0) if kind == 0 else (0.0, size)

    found = minimize_scalar(lambda x: power(made(x)), bounds=ends, method="bounded", options={"maxiter": STEPS})
    return (made(float(found.x)),)


def rest_of(y: Array, X: Array) -> tuple[Array, Array]:
    """Residual (N,) and coefficients (p,) of least squares."""
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    x = np.linalg.lstsq(X / size, y, rcond=1e-10)[0] / size
    return y - X @ x, x


def warmth(scene: Scene) -> tuple[Shape, ...]:
    """Shapes of warming: the recorded temperature (0,), or (T,) s of a rise from the start of each session."""
    T = scene.recording.temperature
    if T is not None and np.ptp(T) > 1.0:
        return ((0.0,),)
    lasting = float(np.ptp(scene.motion.time))
    return tuple((t,) for t in WARM if t < lasting)


def warm(scene: Scene, constant: float) -> Array:
    """(M,) 0 … 1 how warm the joints are."""
    m = scene.motion
    if constant == 0.0 and scene.recording.temperature is not None:
        T = scene.recording.temperature[m.index]
        return np.asarray((T - T.min()) / np.ptp(T))
    starts = np.flatnonzero(np.diff(m.session, prepend=-1))
    since = m.time - m.time[starts][m.session]
    return np.asarray(1.0 - np.exp(-since / constant))


def friction(scene: Scene, joint: int, turn: Turn) -> list[Hypothesis]:
    """Rival laws for one joint.

    Args:
        scene: channel torque, with the predicted torque.
        joint: 0-based.
        turn: how friction turns over in the base.
    """
    m = scene.motion
    if not scene.moves(joint):
        return []
    v = m.v[:, joint]
    load = np.zeros_like(v) if scene.predicted is None else np.abs(scene.predicted[:, joint])
    heavy = max(float(np.quantile(load, 0.98)), 1e-9)
    loaded = scene.predicted is not None and bool(np.ptp(load) > calibrated.MOTION.loaded * heavy)
    pace = Pace(float(np.quantile(np.abs(v), 0.98)), loaded, tuple(t for (t,) in warmth(scene)))
    seen = Rubbing(
        speed=v,
        way=direction(scene, joint, turn),
        load=load,
        first=scene.first,
        step=1.0 / m.rate,
        warmth=lambda constant: warm(scene, constant),
        slides=scene.prismatic[joint],
    )
    laws = ((e, law, law.grid(pace)) for e in registry.of_friction() for law in e.rubs)
    return [
        _law(scene, joint, e, law, seen, tuple(s[:1] for s in grid if s[1:] == rest), rest)
        for e, law, grid in laws
        for rest in dict.fromkeys(s[1:] for s in grid)
    ]


def _law(
    scene: Scene,
    joint: int,
    effect: Effect,
    law: FrictionLaw,
    seen: Rubbing,
    grid: tuple[Shape, ...],
    rest: Shape,
) -> Hypothesis:
    """A law over its first number, which is settled between those of the grid; ``rest`` are the others."""
    unit = "N" if seen.slides else "N·m"

    def columns(s: Shape) -> Array:
        return law.columns(np.array(s + rest), seen)

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(s + rest), seen)

    def line(x: Array, s: Shape) -> Curve:
        return curve(
            scene,
            scene.motion.q[:, joint] if law.by_angle else seen.speed,
            columns(s) @ x,
            f"speed of joint {joint + 1} in {'m' if seen.slides else 'rad'}/s",
            f"friction beyond Coulomb and viscous in {unit}",
        )

    lower = tuple(least for _, _, least in files.named(law, len(law.coefficients)))
    return joint_law(
        scene,
        joint,
        effect.called,
        law.name,
        law.equation,
        columns,
        sizes,
        grid,
        lower=lower if np.isfinite(lower).any() else (),
        note=law.note,
        curve=line,
        family="friction",
    )
