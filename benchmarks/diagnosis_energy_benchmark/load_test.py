"""Load tests of the foreign lab: their noise-free record, with things concealed, and what else would explain it."""

from __future__ import annotations

import dual_quaternions as dq
import elastic_arm
import numpy as np
from dual_quaternions import Array
from effect_strength import Effect, Named, NoiseFreeRecord
from load_test_effects import applied, record_changes
from loading_rig import Rig, joint_columns
from rival_columns import load_rivals


class LoadTest(Rig):
    """One load test; ``clean`` repeats it with other things concealed, same poses and loads."""

    channel = "deflection"
    unit = "mm"

    def clean(self, effects: list[Effect]) -> NoiseFreeRecord:
        build, script = applied(effects, self)
        frames, _ = elastic_arm.solve_rest_states(build, script)
        p, tip = dq.place(frames["tcp"]), frames["tcp"]
        moved = (p - p[self.zero])[self.shown]
        turned = dq.turning(tip, tip[self.zero])[self.shown]
        wrench = self.script.wrench[self.shown]
        wrench, moved, turned = record_changes(effects, self, wrench, moved, turned)
        return self._clean(wrench, moved, turned)

    def _clean(self, wrench: Array, moved: Array, turned: Array) -> NoiseFreeRecord:
        lab, script, keep = self.lab, self.script, self.shown
        y = np.concatenate([moved, turned], axis=1) if lab.turning else moved
        motion, sight = joint_columns(self.nominal, self.rigid)
        known = wrench.copy()
        if lab.moments == "none":
            known[:, 3:] = 0.0
        torque = np.einsum("njc,nc->nj", np.concatenate([motion, sight], axis=2), known)
        base = np.einsum("njd,nj->ndj", np.concatenate([motion, sight], axis=2)[:, :, : y.shape[1]], torque)
        slope = np.einsum("njd,njc,j->ndc", motion, motion, 1.0 / self.nominal.stiffness)
        by_force = lab.force * self.largest * np.linalg.norm(slope, axis=2) / np.sqrt(3)
        sigma = np.sqrt((1e-3 * lab.displacement.reading) ** 2 + by_force**2)
        shared = np.full_like(sigma, 1e-3 * lab.displacement.shared)
        if lab.turning:
            sigma = np.concatenate([sigma, np.full_like(sigma, 1e-3 * lab.rotation.reading)], axis=1)
            shared = np.concatenate([shared, np.full_like(shared, 1e-3 * lab.rotation.shared)], axis=1)
        columns = {
            "q": script.q[keep],
            "wrench": wrench,
            "moved": moved,
            "turned": turned,
            "time": script.time[keep] - script.time[0],
            "pose": self.pose[keep],
            "cycle": script.cycle[keep],
            "session": script.session[keep],
            "unloading": self.unloading[keep],
        }
        return NoiseFreeRecord(columns, y, base, sigma, shared, script.cycle[keep])

    def rivals(self, clean: NoiseFreeRecord) -> dict[Named, Array]:
        return load_rivals(self, clean)
