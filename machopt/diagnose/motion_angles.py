"""Where the arm stands without any load, as a motion sees it: the laws of port angle of the registry.

As in settled poses (``diagnose/at_angle.py``), lifted by what the channel sees of a joint: its link-side encoder, or
J_j at the tip. A law's penalty and prior are of few readings, and a motion has thousands.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from machopt.diagnose import calibrated
from machopt.diagnose.at_angle import hypothesis
from machopt.diagnose.motion_frame import Fit, Scene
from machopt.diagnose.problem import Hypothesis, Shape, Untestable
from machopt.effects import registry
from machopt.effects.protocol import Effect, Swept, Unloaded, joints_of


def lowest_order(scene: Scene, joint: int) -> float:
    """The slowest gear order per turn that this range of a joint (0-based) can show."""
    spread = float(np.ptp(scene.motion.q[:, joint]))
    return max(
        calibrated.MOTION.slowest_order, float(np.ceil(calibrated.MOTION.turns * 2.0 * np.pi / max(spread, 1e-9)))
    )


def hypotheses(scene: Scene, joint: int, fit: Fit) -> tuple[list[Hypothesis], list[Untestable]]:
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
                if grid:
                    out.setdefault((effect.called, where), []).append(_hypothesis(scene, effect, where, law, grid))
    kept: list[Hypothesis] = []
    untestable: list[Untestable] = []
    for (effect_name, where), laws in out.items():
        shown = [h for h in laws if fit.left_of(h.columns(h.shapes[len(h.shapes) // 2])) > calibrated.RESTING.taken_up]
        kept += shown
        if not shown:
            untestable.append(Untestable(effect_name, where, "what is refitted in any case takes it up"))
    return kept, untestable


def swept(scene: Scene, joint: int) -> Swept:
    """What the angles of a joint (0-based) in a motion can show."""
    q = scene.motion.q[:, joint]
    return Swept(float(q.min()), float(q.max()), len(q), lowest_order(scene, joint), sampled=True)


def _hypothesis(scene: Scene, effect: Effect, where: str, law: Unloaded, grid: tuple[Shape, ...]) -> Hypothesis:
    by, moved = joints_of(where)
    q = scene.motion.q[:, by]
    return hypothesis(effect, where, law, grid, q, partial(scene.column, moved), scene.motion.mean(q))
