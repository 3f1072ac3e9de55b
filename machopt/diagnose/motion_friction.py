"""What friction does beyond Coulomb and viscous, per joint: rival laws on the motor's torque.

The base has, for each joint, offset, Coulomb c z and viscous d q̇, with z the direction of motion after a short
breakaway path (:func:`machopt.diagnose.motion_memory.presliding`). A Coulomb torque that differs with the direction
is an offset and a Coulomb torque; it is told from a load that the model lacks by nothing, so it stays in the base.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.diagnose.motion_frame import Scene, curve, joint_law
from machopt.diagnose.motion_memory import presliding
from machopt.diagnose.problem import Array, Hypothesis, Quantity, Shape

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
    (0.0, 0.003),
    (0.0, 0.01),
    (0.0, 0.03),
    (0.0, 0.1),
)
DRAG = (0.01, 0.03, 0.08, 0.2)  # rad; slip on paths this long is no breakaway of a gear but something dragged along
STRIBECK = (0.03, 0.06, 0.12, 0.25, 0.5)  # of the joint's largest speed
WARM = (15.0, 60.0, 300.0)  # s


def direction(scene: Scene, joint: int, turn: Turn) -> Array:
    """(M,) −1 … 1, which way a joint's friction points."""
    return turned(scene, scene.motion.v[:, joint], turn)


def turned(scene: Scene, v: Array, turn: Turn) -> Array:
    """The same of a speed (M,) rad/s: after a breakaway path, which is late, or over a speed, which is not."""
    path, speed = turn
    if speed > 0:
        return np.asarray(np.tanh(v / speed))
    return presliding(v, 1.0 / scene.motion.rate, scene.first, path)


def breakaway(scene: Scene, joint: int, y: Array) -> Turn:
    """The turn-over that suits a joint's torque (N,) best, Coulomb, viscous and inertia beside."""
    m = scene.motion
    rest = m.within(m.mean(np.stack([np.ones(len(m.q)), m.v[:, joint], m.a[:, joint]], axis=1)))
    best, found = np.inf, TURNS[0]
    for turn in TURNS:
        z = m.within(m.mean(direction(scene, joint, turn)[:, None]))
        power = float(np.sum(rest_of(y, np.concatenate([rest, z], axis=1))[0] ** 2))
        if power < 0.995 * best:
            best, found = power, turn
    return found


def rest_of(y: Array, X: Array) -> tuple[Array, Array]:
    """Residual (N,) and coefficients (p,) of least squares."""
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    x = np.linalg.lstsq(X / size, y, rcond=1e-10)[0] / size
    return y - X @ x, x


def warmth(scene: Scene) -> tuple[tuple[Shape, ...], str]:
    """Shapes of warming: the recorded temperature (0,), or (T,) s of a rise from the start of each session."""
    T = scene.recording.temperature
    if T is not None and np.ptp(T) > 1.0:
        return ((0.0,),), "recorded temperature"
    lasting = float(np.ptp(scene.motion.time))
    return tuple((t,) for t in WARM if t < lasting), "time since the start"


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
    v, z = m.v[:, joint], direction(scene, joint, turn)
    load = np.zeros_like(v) if scene.predicted is None else np.abs(scene.predicted[:, joint])
    fast = float(np.quantile(np.abs(v), 0.98))
    heavy = max(float(np.quantile(load, 0.98)), 1e-9)
    heat, by = warmth(scene)
    unit, way, angle = ("N", "mm", 1e3) if scene.prismatic[joint] else ("N·m", "deg", 180.0 / np.pi)

    def stribeck(s: Shape) -> Array:
        return z * np.exp(-np.abs(v) / (s[0] * fast))

    def lopsided(s: Shape) -> Array:
        return np.stack([np.abs(v) / fast, np.exp(-np.abs(v) / (0.15 * fast))], axis=1)

    def loaded(s: Shape) -> Array:
        return z * load / heavy

    def rising(s: Shape) -> Array:
        w = warm(scene, s[0])
        return np.stack([w * z, w * v / fast], axis=1)

    def all_of_it(s: Shape) -> Array:
        low = np.exp(-np.abs(v) / (s[0] * fast))
        parts = [z * low, np.abs(z) * low, z * load / heavy]
        if len(s) > 1:
            parts.append(warm(scene, s[1]) * v / fast)
        return np.stack(parts, axis=1)

    def dragged(s: Shape) -> Array:
        return presliding(v, 1.0 / m.rate, scene.first, s[0])

    def curved(s: Shape) -> Array:
        return np.stack([np.sign(v) * (np.abs(v) / fast) ** 2, z * np.sqrt(np.abs(v) / fast)], axis=1)

    def law(name: str, equation: str, signal, shapes, first: str, more=None, note: str = "", at=None):  # type: ignore[no-untyped-def]
        def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
            part = signal(s)
            added = part * x[0] if part.ndim == 1 else part @ x
            out = {first: Quantity(float(np.quantile(np.abs(added - np.median(added)), 0.98)), unit)}
            return out | ({} if more is None else more(x, s))

        def line(x: Array, s: Shape):  # type: ignore[no-untyped-def]
            part = signal(s)
            over = f"speed of joint {joint + 1} in {'m' if scene.prismatic[joint] else 'rad'}/s"
            return curve(
                scene,
                v if at is None else at,
                part * x[0] if part.ndim == 1 else part @ x,
                over,
                f"friction beyond Coulomb and viscous in {unit}",
            )

        return joint_law(
            scene,
            joint,
            "joint_friction",
            name,
            equation,
            signal,
            sizes,
            shapes,
            note=note,
            curve=line,
            family="friction",
        )

    def knee(x: Array, s: Shape) -> Mapping[str, Quantity]:
        return {"stribeck_speed": Quantity(s[0] * fast * angle, f"{way}/s")}

    slow = tuple((k,) for k in STRIBECK)
    both = tuple((k, h[0]) for k in STRIBECK for h in heat) or slow
    source = "; Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083"
    laws = [
        law("Stribeck", "τ_f += z F_s exp(−|q̇|/v_s)" + source, stribeck, slow, "stribeck", knee, "at low speed"),
        law(
            "other in the other direction",
            "τ_f += d |q̇| + F exp(−|q̇|/v)",
            lopsided,
            ((),),
            "lopsided",
            None,
            "differs with the direction",
        ),
        law(
            "viscous bends",
            "τ_f += d₂ q̇|q̇| + d₁ z √|q̇|: shear thinning of grease",
            curved,
            ((),),
            "torque",
            None,
            "over speed",
        ),
        law(
            "Stribeck, load, direction" + (", warmth" if heat else ""),
            "τ_f += (z F_s + F_d) exp(−|q̇|/v_s) + μ z |τ| + d_w w q̇; w " + by + source,
            all_of_it,
            both,
            "stribeck",
            knee,
            "over speed, load and warmth",
        ),
        law(
            "dragged along",
            "τ_f += F z, dz = (sgn q̇ − z) |dq|/d with a long path d: cables, hoses, seals",
            dragged,
            tuple((d,) for d in DRAG),
            "torque",
            lambda x, s: {"path": Quantity(s[0] * angle, way)},
            "after reversals",
            m.q[:, joint],
        ),
    ]
    if scene.predicted is not None and np.ptp(load) > 0.05 * heavy:
        laws.insert(1, law("load-dependent", "τ_f += μ z |τ|", loaded, ((),), "torque", None, "grows with the load"))
    if heat:
        laws.append(law("warms up", f"τ_f += (F_w z + d_w q̇) w, w the {by}", rising, heat, "torque", None, "over time"))
    return laws
