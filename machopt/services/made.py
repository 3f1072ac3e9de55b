"""Everything one run of ``machopt optimize`` came to, before it is told."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.domain.cell import Cell
from machopt.domain.manifest import Manifest, ManifestProgram, TouchingPair, with_scope
from machopt.domain.options import PlanOptions
from machopt.domain.stint import Stint
from machopt.domain.toolpath import Toolpath
from machopt.plan.job.pareto import Point
from machopt.plan.motion.timeline import Timeline
from machopt.plan.pipeline.planned import Plan
from machopt.plan.written.points import PointResults
from machopt.postprocess.written import Written, read_back
from machopt.recheck.scope import done, not_run, production_blockers
from machopt.verify import Verification


@dataclass(frozen=True)
class MadeStint:
    """What one tool that is on came to: what its robot program is made of."""

    stint: Stint
    plan: Plan  # its toolpath indices count from the stint's first point
    timeline: Timeline | None


@dataclass(frozen=True, kw_only=True)
class Made:
    """Everything one run came to, before it is told."""

    cell: Cell
    toolpath: Toolpath
    options: PlanOptions
    stints: tuple[MadeStint, ...]  # one, or one a tool that is on where the job changes it
    plan: Plan
    points: PointResults
    timeline: Timeline | None
    verification: Verification | None
    programs: tuple[Written, ...]
    front: tuple[Point, ...] = ()  # the trade-off, where it was asked for
    manifest: Manifest  # without files; names inputs, reading options and what is not checked

    @property
    def exit_code(self) -> int:
        """0 done, 3 no feasible answer, 4 verification failed."""
        if self.timeline is None or self.timeline.trajectory is None:
            return 3
        held = self.verification is None or self.verification.ok
        return 0 if held and all(p.ok for p in self.programs) else 4

    @property
    def verdict(self) -> str:
        """The verdict with what it does not cover."""
        word = {3: "infeasible", 4: "verification failed"}.get(self.exit_code)
        word = word or self._gaps
        return with_scope(word, self.unchecked)

    @property
    def unchecked(self) -> tuple[str, ...]:
        """What the verdict does not cover."""
        return (*self.manifest.unchecked, *(not_run(self.verification.checks) if self.verification else ()))

    @property
    def production_blockers(self) -> tuple[str, ...]:
        """What has to be settled before the part is made; nothing where there is no motion to make it with."""
        if self.exit_code == 3:
            return ()
        return production_blockers(self.cell, self.unchecked, [p.as_result() for p in self.programs])

    @property
    def _gaps(self) -> str:
        """How much of the toolpath is done."""
        path, missing = self.plan.path, self.plan.missing
        points = missing[path.is_point[missing]]
        cut = int(path.counted[points].sum())
        return done(cut, len(points) - cut)

    def with_programs(self, programs: tuple[Written, ...]) -> Made:
        """The same with these programs, in the manifest too; one that is withheld has no files."""
        named = tuple(ManifestProgram(p.label, p.files, p.stint) for p in programs if p.files)
        said = tuple(f"{p.files[0]}: {text}" for p in programs if p.files for text in (*p.unstarted, *p.assumed))
        return replace(self, programs=programs, manifest=replace(self.manifest, programs=named, warnings=said))

    def with_touching_pairs(self) -> Made:
        """The same with the pairs of bodies that the planner leaves out, in the manifest."""
        models = [s.plan.setup.collision for s in self.stints]
        pairs = {(e.a, e.b): e.reason for m in models if m is not None for e in m.excluded if np.isfinite(e.share)}
        listed = tuple(TouchingPair(a, b, reason) for (a, b), reason in pairs.items())
        return replace(self, manifest=replace(self.manifest, touching_pairs=listed))

    def verified(self, found: Verification) -> Made:
        """The same with what the verification found, of each program too."""
        return replace(self, verification=found, programs=read_back(self.programs, found))
