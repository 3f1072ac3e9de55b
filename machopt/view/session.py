"""Session of ``machopt view``: a loaded problem and its plans, independent of the browser."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from machopt.commands.input_hashes import map_hashes_by_name
from machopt.commands.manifest import list_option_fields
from machopt.commands.optimize.computation import OptimizeComputation, compute_optimize_plan
from machopt.commands.optimize.request import OptimizeInputs
from machopt.commands.optimize.verified_files import write_verified_files
from machopt.data_types.cell import Cell
from machopt.data_types.documents.view_document import ViewAnswerDocument
from machopt.data_types.plan_options import PlanOptions, SteeringRule
from machopt.data_types.steering_rules import list_steered_stretches, refuse_narrow_zones, resolve_steering
from machopt.errors import InputError
from machopt.options.plan_option_reader import format_user_options, load_options
from machopt.output.single_file import write_text_file
from machopt.planning.cache import StepCache, use_step_cache
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.job.constraint_conflicts import is_complete
from machopt.planning.pipeline.planning_setup import Progress, StageTimings
from machopt.planning.plan_output.infeasibility_reasons import list_breaks
from machopt.report.page_data.optimize import PlanEvidence, build_report_data, format_measured_value
from machopt.report.page_types.steering_panel_data import SteeringAxis, SteeringData
from machopt.report.pages.optimize.optimize_page import build_report_html
from machopt.view.dragged_point_outcomes import LiveJob, has_tolerances
from machopt.view.plan_comparison import compare_plans

_CHECK_TEXTS = {True: "passed", False: "FAILED", None: "not run"}
WISH_KEYS = ("fixed", "steer", "external")  # of a plan file, that the page may set


@dataclass(kw_only=True)
class ViewSession:
    """One cell and toolpath with the shown plan and the previous one."""

    optimize_inputs: OptimizeInputs
    file: Path  # where the plan file is saved
    words: tuple[str, ...]  # of the command that plans the same anew, without the plan file
    current: OptimizeComputation
    previous: OptimizeComputation | None = None
    message: str = ""
    has_motion: bool = True
    overwrite: bool = False  # replace whatever file is where the plan is saved
    inputs: tuple[Path, ...] = ()  # files that were read
    verifications: list[tuple[OptimizeComputation, ViewAnswerDocument]] = field(
        default_factory=list
    )  # of verify, of plans shown or before
    cache: StepCache = field(default_factory=StepCache)  # what the steps of earlier plans came to
    live: LiveJob | None = None  # the shown plan, for handles that are dragged

    @classmethod
    def start(
        cls,
        optimize_inputs: OptimizeInputs,
        file: Path,
        words: tuple[str, ...],
        progress: Progress,
        *,
        overwrite: bool = False,
        inputs: tuple[Path, ...] = (),
    ) -> ViewSession:
        """Compute the first plan, and return the session.

        Args:
            optimize_inputs: The loaded inputs.
            file: Plan file that the page may write.
            words: Planning options of the command line.
            progress: Called with the name of each stage when it begins.
            overwrite: Replace the plan file whatever it holds.
            inputs: Input files, which must never be overwritten.
        """
        store = StepCache()
        with use_step_cache(store):
            made = compute_optimize_plan(optimize_inputs, StageTimings(progress=progress))
        message, good = _describe_outcome(made)
        return cls(
            optimize_inputs=optimize_inputs,
            file=file,
            words=words,
            current=made,
            message=message,
            has_motion=good,
            overwrite=overwrite,
            inputs=inputs,
            cache=store,
        )

    def list_wishes(self) -> dict[str, Any]:
        """Return the steering rules of the shown plan, under the keys of a plan file."""
        user = format_user_options(self.current.inputs.options)
        return {"fixed": user["fixed"], "steer": user.get("steer", []), "external": user.get("external", {})}

    def replan(self, wishes: dict[str, Any], progress: Progress) -> tuple[str, bool]:
        """Plan again with other steering rules; unchanged steps come from the cache.

        Args:
            wishes: The rules, under the keys of a plan file.
            progress: Called with the name of each stage when it begins.

        Returns:
            A message, and whether the new plan is shown now: a plan without a motion does not replace one with a
            motion.

        Raises:
            InputError: a rule is not valid; the shown plan stays.
        """
        options = self._build_options(wishes)
        if self.has_motion and format_user_options(options) == format_user_options(self.current.inputs.options):
            return "Nothing is changed: the plan shown stays, with its verification.", True
        old = [segment.plan for segment in self.current.job_result.segments]
        lends = old if all(p.compensation is None for p in old) else ()  # its path is another one
        given = self.optimize_inputs
        manifest = replace(given.manifest, **list_option_fields(given.cell, options, given.toolpath))
        with use_step_cache(self.cache):
            made = compute_optimize_plan(
                replace(given, options=options, manifest=manifest), StageTimings(progress=progress), lends
            )
        message, good = _describe_outcome(made)
        if self.has_motion and not good:
            return message, False
        self.previous, self.current, self.message, self.has_motion = self.current, made, message, good
        return message, True

    def swap_plans(self) -> None:
        """Exchange the shown plan and the previous one."""
        if self.previous is not None:
            self.previous, self.current = self.current, self.previous
            self.message, self.has_motion = _describe_outcome(self.current)

    def save_plan_file(self) -> str:
        """Write the plan file; return its command."""
        write_text_file(self.file, self.plan_text(), force=self.overwrite, inputs=self.inputs)
        return self.command

    def verify(self, progress: Progress) -> ViewAnswerDocument:
        """Write the shown plan with its programs to a temporary folder, and verify it against cell and toolpath.

        The checks share no code with the planner.

        Args:
            progress: Called with the name of each stage when it begins.

        Returns:
            What the page shows: a sentence, whether all checks passed, and every check.
        """
        with TemporaryDirectory(prefix="machopt-view-") as place:
            timed = replace(self.current, timings=StageTimings(progress=progress))
            found = write_verified_files(
                replace(timed, inputs=replace(self.current.inputs, front=False)), Path(place)
            ).verification
        if found is None:
            return ViewAnswerDocument(message="There is no motion to verify.", good=False)
        rows = tuple(
            (
                c.name,
                _CHECK_TEXTS[c.passed],
                format_measured_value(c.value, c),
                format_measured_value(c.limit, c),
                c.where,
            )
            for c in found.checks
        )
        good, bad = sum(c.passed is True for c in found.checks), [c.name for c in found.failed]
        message = f"Verification passed: {good} checks of every file that optimize would write."
        if bad:
            message = f"VERIFICATION FAILED: {', '.join(bad)}."
        if left := [c.name for c in found.checks if c.passed is None]:
            message += f" Not run: {', '.join(left)}."
        answer = ViewAnswerDocument(message=message, good=not bad, checks=rows)
        shown = [one for one in self.verifications if one[0] is self.previous]
        self.verifications = [*shown, (self.current, answer)]
        return answer

    def find_outcome(self, body: dict[str, Any]) -> ViewAnswerDocument:
        """Return outcome and error of a point of the shown plan at another rotation.

        Args:
            body: ``point``, a toolpath point, and ``phi_deg``, the rotation about the transported reference.

        Raises:
            InputError: a value is missing or out of range.
        """
        if self.live is None or self.live.made is not self.current.job_result:
            self.live = LiveJob.build(self.current.job_result)
        return ViewAnswerDocument(message="", good=True, outcome=self.live.find_outcome(body))

    @property
    def _verification(self) -> ViewAnswerDocument | None:
        """Of the plan shown."""
        return next((answer for plan, answer in self.verifications if plan is self.current), None)

    @property
    def command(self) -> str:
        """Command that computes the same plan."""
        return " ".join(["machopt optimize", *self.words, "--plan", str(self.file)])

    def plan_text(self) -> str:
        """Options of the shown plan as a plan file: YAML 1.2, which includes JSON."""
        user = {"machopt_plan": 1, **format_user_options(self.current.inputs.options)}
        user.setdefault("steer", [])  # an empty list takes the place of one in cell.yaml
        lines = ["# yaml-language-server: $schema=plan.schema.json"]
        for key, value in user.items():
            if isinstance(value, list) and value:
                lines += [f"{key}:", *(f"  - {_format_yaml_flow(item)}" for item in value)]
            else:
                lines.append(f"{key}: {_format_yaml_flow(value)}")
        return "\n".join(lines) + "\n"

    def build_html(self) -> str:
        """Return the page: the report of the shown plan, and the steering panel."""
        made, timings = self.current.job_result, self.current.timings
        evidence = PlanEvidence(
            shown=made.shown,
            blockers=made.production_blockers,
            before=None if self.previous is None else self.previous.job_result.plan,
            hashes=map_hashes_by_name(made.manifest.inputs),
            options=format_user_options(made.options),
            timings=timings.seconds,
        )
        data = build_report_data(made.plan, made.toolpath, made.points, made.timeline, evidence)
        return build_report_html(data, self._build_steering_data())

    def _build_options(self, wishes: dict[str, Any]) -> PlanOptions:
        unknown = sorted(set(wishes) - set(WISH_KEYS))
        if unknown:
            raise InputError(f"found {', '.join(unknown)}; {', '.join(WISH_KEYS)} can be set here", file="view")
        base = format_user_options(self.optimize_inputs.options)
        option_values = {**base, **{k: wishes.get(k, base.get(k, [])) for k in WISH_KEYS}}
        if not option_values["external"]:
            del option_values["external"]
        options = load_options(**option_values)
        if any(f.point >= len(self.optimize_inputs.toolpath) for f in options.fixed):
            raise InputError(
                f"the toolpath has points 0 to {len(self.optimize_inputs.toolpath) - 1}", file="view", where="fixed"
            )
        resolve_steering(options, self.optimize_inputs.toolpath)
        refuse_narrow_zones(options)
        resolve_axis_options(self.optimize_inputs.cell, options)
        return options

    def _build_steering_data(self) -> SteeringData:
        cell, toolpath = self.optimize_inputs.cell, self.optimize_inputs.toolpath
        plan = self.current.job_result.plan
        labels = list(dict.fromkeys(o.label for o in toolpath.operations))
        parts = [(label, tuple(list_steered_stretches(SteeringRule(operation=label), toolpath))) for label in labels]
        return SteeringData(
            operations=tuple((label, points) for label, points in parts if points),
            points=len(toolpath),
            branches=plan.setup.arm.solver.branches if plan.candidates.stable else 0,
            axes=tuple(_build_axis(cell, k) for k in range(len(cell.external_joints))),
            wishes=self.list_wishes(),
            compared=compare_plans(
                self.current.job_result, None if self.previous is None else self.previous.job_result
            ),
            message=self.message,
            has_motion=self.has_motion,
            file=str(self.file),
            command=self.command,
            has_tolerances=has_tolerances(cell),
            verified=None if (answer := self._verification) is None else answer.to_json_types(),
        )


def _build_axis(cell: Cell, k: int) -> SteeringAxis:
    unit, per = ("mm", 1e3) if cell.external_prismatic[k] else ("deg", float(np.degrees(1.0)))
    low, high = (float(values[6 + k]) * per for values in (cell.limits.lower, cell.limits.upper))
    return SteeringAxis(cell.external_joints[k], unit, low, high)


def _describe_outcome(optimize_computation: OptimizeComputation) -> tuple[str, bool]:
    """A sentence on what came of it, and whether there is a motion."""
    plan, timeline = optimize_computation.job_result.plan, optimize_computation.job_result.timeline
    seconds = sum(optimize_computation.timings.seconds.values())
    if timeline is not None and timeline.trajectory is not None:
        return f"Planned in {seconds:.1f} s.", True
    if plan.conflict:
        return plan.conflict, False
    breaks = list_breaks(plan, timeline.obstructions if timeline else ())
    if breaks:
        return f"No continuous motion {breaks[0].where}: {breaks[0].text}.", False
    return ("No motion was found." if is_complete(plan) else "Some points have no posture; the page lists them."), False


def _format_yaml_flow(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
