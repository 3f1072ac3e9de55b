"""Result of one run of ``machopt optimize``."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.manifest import FolderManifest, ManifestProgram, TouchingPair, add_scope_to_verdict
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.stock import StockSummary
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.planning.job.pareto_front import FrontPlan
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.collision_map import CollisionMap
from machopt.planning.plan_output.point_table import PointResults
from machopt.program_export.exported_programs import ExportedProgram, add_read_back_results
from machopt.verification import Verification
from machopt.verification.folder.verification_scope import (
    format_completeness,
    list_checks_not_run,
    list_production_blockers,
)


@dataclass(frozen=True)
class ToolSegmentResult:
    """Result of one tool segment, from which its robot program is made."""

    segment: ToolSegment
    plan: Plan  # its toolpath indices count from the segment's first point
    timeline: MotionTimeline | None


@dataclass(frozen=True, kw_only=True)
class OptimizeJobResult:
    """Complete result of one run."""

    cell: Cell
    toolpath: Toolpath
    options: PlanOptions
    segments: tuple[ToolSegmentResult, ...]  # one, or one a tool that is on where the job changes it
    plan: Plan  # without the joints of the candidate grid
    points: PointResults
    shown: CollisionMap  # of the feasible rotations and branches, for the pages
    timeline: MotionTimeline | None
    verification: Verification | None
    programs: tuple[ExportedProgram, ...]
    front: tuple[FrontPlan, ...] = ()  # the trade-off front, if requested
    manifest: FolderManifest  # without files; names inputs, reading options and what is not checked
    stock: StockSummary | None = None  # what the job does to its stock; None where no engagement comes from there

    @property
    def exit_code(self) -> int:
        """Exit code: 0 done, 3 infeasible, 4 verification failed."""
        if self.timeline is None or self.timeline.trajectory is None:
            return 3
        is_verified = self.verification is None or self.verification.ok
        return 0 if is_verified and all(p.ok for p in self.programs) else 4

    @property
    def verdict(self) -> str:
        """The verdict with what it does not cover."""
        word = {3: "infeasible", 4: "verification failed"}.get(self.exit_code)
        word = word or self._completeness_word
        return add_scope_to_verdict(word, self.unchecked)

    @property
    def unchecked(self) -> tuple[str, ...]:
        """What the verdict does not cover."""
        return (*self.manifest.unchecked, *(list_checks_not_run(self.verification.checks) if self.verification else ()))

    @property
    def production_blockers(self) -> tuple[str, ...]:
        """What has to be settled before production; empty where there is no motion."""
        if self.exit_code == 3:
            return ()
        return list_production_blockers(self.cell, self.unchecked, [p.to_document() for p in self.programs])

    @property
    def _completeness_word(self) -> str:
        """How much of the toolpath is done."""
        path, missing = self.plan.path, self.plan.missing
        points = missing[path.is_point[missing]]
        cut = int(path.counted[points].sum())
        return format_completeness(cut, len(points) - cut)

    def with_programs(self, programs: tuple[ExportedProgram, ...]) -> OptimizeJobResult:
        """Return a copy with these programs, in the manifest too; an omitted program has no files.

        Args:
            programs: The exported programs.
        """
        named = tuple(ManifestProgram(p.label, p.files, p.tool_segment) for p in programs if p.files)
        notes = tuple(
            f"{p.files[0]}: {text}" for p in programs if p.files for text in (*p.unstarted_events, *p.assumptions)
        )
        return replace(self, programs=programs, manifest=replace(self.manifest, programs=named, warnings=notes))

    def with_touching_pairs(self) -> OptimizeJobResult:
        """Return a copy with the pairs of bodies that the planner leaves out, in the manifest."""
        models = [s.plan.setup.collision for s in self.segments]
        pairs = {(e.a, e.b): e.reason for m in models if m is not None for e in m.excluded if np.isfinite(e.share)}
        listed = tuple(TouchingPair(a, b, reason) for (a, b), reason in pairs.items())
        return replace(self, manifest=replace(self.manifest, touching_pairs=listed))

    def with_verification(self, verification: Verification) -> OptimizeJobResult:
        """Return a copy with the verification, also for each program.

        Args:
            verification: The verification of the output folder.
        """
        return replace(self, verification=verification, programs=add_read_back_results(self.programs, verification))
