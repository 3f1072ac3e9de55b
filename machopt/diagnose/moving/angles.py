"""Where the arm stands without any load, as a motion sees it: the laws of port angle of the registry.

As in settled poses (``diagnose/laws/at_angle.py``), lifted by what the channel sees of a joint: its link-side encoder,
or J_j at the tip. A law's penalty and prior are of few readings, and a motion has thousands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from machopt.diagnose import calibrated
from machopt.diagnose.laws.at_angle import hypothesis
from machopt.diagnose.laws.motion_frame import PowerTaken, Scene
from machopt.diagnose.nouns.problem import Finer, Hypothesis, Shape, Untestable
from machopt.domain.location import joints_of
from machopt.effects import registry
from machopt.effects.protocol import Effect, Swept, Unloaded

FINE = 31  # orders about one that are profiled


def lowest_order(scene: Scene, joint: int, turns: float) -> float:
    """The slowest gear order per turn of which this range of a joint (0-based) shows so many waves."""
    return max(calibrated.MOTION.slowest_order, float(np.ceil(turns * _apart(scene, joint))))


def _apart(scene: Scene, joint: int) -> float:
    """Orders per turn by which two waves differ by one over the range of a joint."""
    return 2.0 * np.pi / max(float(np.ptp(scene.motion.q[:, joint])), 1e-9)


def orders(scene: Scene, joint: int) -> Finer:
    """An order is as sure as the range of its joint lets it be: whole where the data agree, else an interval."""
    apart = _apart(scene, joint)

    def about(shape: Shape, share: float) -> tuple[Shape, ...]:
        n = shape[0]
        fine = np.linspace(max(n - share * apart, 0.5), n + share * apart, FINE)
        whole = np.arange(np.ceil(fine[0]), np.floor(fine[-1]) + 1.0)
        return tuple(tuple(float(v * k / n) for k in shape) for v in sorted({n, *fine, *whole}))

    def said(shapes: Sequence[Shape]) -> str:
        low, high = min(s[0] for s in shapes), max(s[0] for s in shapes)
        if high - low < 1.0:
            return ""
        return f"order not resolved (between {low:.1f} and {high:.1f} a turn): the joint turns by {360.0 / apart:.0f}°"

    return Finer(
        about=about, plain=lambda s: float(s[0]).is_integer(), said=said, apart=calibrated.MOTION.beats * apart
    )


def hypotheses(scene: Scene, joint: int, fit: PowerTaken) -> tuple[list[Hypothesis], list[Untestable]]:
    """Every law at every place that moves this joint (0-based), where the motion can show one.

    Also those that the channel's base takes up: an angle that grows with the joint's own torque, say.
    """
    out: dict[tuple[str, str], list[Hypothesis]] = {}
    for effect in registry.of_angles():
        for where in effect.tried:
            by, moved = joints_of(where)
            if moved != joint or by >= scene.joints or scene.prismatic[by] or scene.prismatic[moved]:
                continue
            for law in effect.unloaded:
                grid = law.grid(swept(scene, by)) if scene.moves(by) else ()
                found = out.setdefault((effect.called, where), [])
                if grid:
                    found.append(_hypothesis(scene, effect, where, law, grid))
                slow = _slow(scene, by, law, grid)
                if slow:
                    found.append(_few_waves(_hypothesis(scene, effect, where, law, slow)))
    out = {name: laws for name, laws in out.items() if laws}
    kept: list[Hypothesis] = []
    untestable: list[Untestable] = []
    for (effect_name, where), laws in out.items():
        shown = [h for h in laws if fit.left_of(h.columns(h.shapes[len(h.shapes) // 2])) > calibrated.RESTING.taken_up]
        kept += shown
        if not shown:
            untestable.append(Untestable(effect_name, where, "what is refitted in any case takes it up"))
    return kept, untestable


def _slow(scene: Scene, by: int, law: Unloaded, grid: tuple[Shape, ...]) -> tuple[Shape, ...]:
    """Orders of which the range shows part of a wave or little more, without which a faster one would be named."""
    if not law.ranged or not scene.moves(by) or any(len(s) != 1 for s in grid):
        return ()
    q = scene.motion.q[:, by]
    most = lowest_order(scene, by, calibrated.MOTION.turns)
    few = Swept(
        float(q.min()), float(q.max()), len(q), lowest_order(scene, by, calibrated.MOTION.few_turns), sampled=True
    )
    slow = tuple(s for s in law.grid(few) if len(s) == 1 and s[0] < 2.0 * most)
    return slow if any(s[0] < most for s in slow) else ()


def _few_waves(h: Hypothesis) -> Hypothesis:
    """Anything smooth looks like part of a wave: it has to say more than a law of few numbers."""
    return replace(h, law=f"{h.law}, slow", penalty=h.penalty + calibrated.MOTION.of_few_turns)


def swept(scene: Scene, joint: int) -> Swept:
    """What the angles of a joint (0-based) in a motion can show."""
    q = scene.motion.q[:, joint]
    return Swept(
        float(q.min()), float(q.max()), len(q), lowest_order(scene, joint, calibrated.MOTION.turns), sampled=True
    )


def _hypothesis(scene: Scene, effect: Effect, where: str, law: Unloaded, grid: tuple[Shape, ...]) -> Hypothesis:
    by, moved = joints_of(where)
    q = scene.motion.q[:, by]
    bare = hypothesis(effect, where, law, grid, q, partial(scene.column, moved), scene.motion.mean(q))
    return replace(bare, finer=orders(scene, by), summed=law.summed) if law.ranged else bare
