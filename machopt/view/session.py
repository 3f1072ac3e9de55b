"""A loaded problem and its plans: what the user steers, without anything of a browser."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions, Steer
from machopt.domain.results.view import ViewAnswer
from machopt.domain.steering import refuse_narrow, steered, stretches
from machopt.errors import InputError
from machopt.formats.options import load_options, options_as_user
from machopt.output.single_file import write_text_file
from machopt.plan.external.axes import axes_of
from machopt.plan.job.conflict import whole
from machopt.plan.kept import Store, keeping
from machopt.plan.pipeline.setup import Progress, Timings
from machopt.plan.written.contact_map import mapped
from machopt.plan.written.explain import all_breaks
from machopt.report.gather.optimize import measured, report_data
from machopt.report.page import report_html
from machopt.report.steering import Axis, Steering
from machopt.services.inputs import hashes_of
from machopt.services.load import Loaded
from machopt.services.manifest import under
from machopt.services.planned import Planned, planned
from machopt.services.written import write
from machopt.view.compare import compared

_PASSED = {True: "passed", False: "FAILED", None: "not run"}
KEYS = ("fixed", "steer", "external")  # of a plan file, that the page may set


@dataclass(kw_only=True)
class Session:
    """One cell and toolpath; the plan shown, and the one it is compared with."""

    given: Loaded
    file: Path  # where the plan file is saved
    words: tuple[str, ...]  # of the command that plans the same anew, without the plan file
    now: Planned
    before: Planned | None = None
    told: str = ""
    good: bool = True
    overwrite: bool = False  # replace whatever file is where the plan is saved
    inputs: tuple[Path, ...] = ()  # files that were read
    answers: list[tuple[Planned, ViewAnswer]] = field(default_factory=list)  # of verify, of plans shown or before
    kept: Store = field(default_factory=Store)  # what the steps of earlier plans came to

    @classmethod
    def begun(
        cls,
        given: Loaded,
        file: Path,
        words: tuple[str, ...],
        progress: Progress,
        *,
        overwrite: bool = False,
        inputs: tuple[Path, ...] = (),
    ) -> Session:
        """Plan as asked."""
        store = Store()
        with keeping(store):
            made = planned(given, Timings(progress=progress))
        told, good = _outcome(made)
        return cls(
            given=given,
            file=file,
            words=words,
            now=made,
            told=told,
            good=good,
            overwrite=overwrite,
            inputs=inputs,
            kept=store,
        )

    def wishes(self) -> dict[str, Any]:
        """What the plan shown was steered by, under the keys of a plan file."""
        user = options_as_user(self.now.given.options)
        return {"fixed": user["fixed"], "steer": user.get("steer", []), "external": user.get("external", {})}

    def replan(self, wishes: dict[str, Any], progress: Progress) -> tuple[str, bool]:
        """Plan anew with other wishes; what they do not change is taken from the plan shown.

        Returns:
            what came of it, and whether the new plan is shown now: one without a motion takes the place of none that
            has one.

        Raises:
            InputError: a wish that cannot be meant; the plan shown stays.
        """
        options = self._options(wishes)
        if self.good and options_as_user(options) == options_as_user(self.now.given.options):
            return "Nothing is changed: the plan shown stays, with its verification.", True
        old = [stint.plan for stint in self.now.made.stints]
        lends = old if all(p.compensation is None for p in old) else ()  # its path is another one
        given = self.given
        manifest = replace(given.manifest, **under(given.cell, options, given.toolpath))
        with keeping(self.kept):
            made = planned(replace(given, options=options, manifest=manifest), Timings(progress=progress), lends)
        told, good = _outcome(made)
        if self.good and not good:
            return told, False
        self.before, self.now, self.told, self.good = self.now, made, told, good
        return told, True

    def back(self) -> None:
        """Change the plan shown for the one before."""
        if self.before is not None:
            self.before, self.now = self.now, self.before
            self.told, self.good = _outcome(self.now)

    def save(self) -> str:
        """Write the plan file; its command."""
        write_text_file(self.file, self.plan_text(), force=self.overwrite, inputs=self.inputs)
        return self.command

    def verified(self, progress: Progress) -> ViewAnswer:
        """Write the plan shown to a folder of its own, programs included, and hold it against cell and toolpath.

        The checks share no code with the planner. The folder is gone afterwards.

        Returns:
            what the page shows: a sentence, whether all is well, and every check.
        """
        with TemporaryDirectory(prefix="machopt-view-") as place:
            timed = replace(self.now, timings=Timings(progress=progress))
            found = write(replace(timed, given=replace(self.now.given, front=False)), Path(place)).verification
        if found is None:
            return ViewAnswer(told="There is no motion to verify.", good=False)
        rows = tuple(
            (c.name, _PASSED[c.passed], measured(c.value, c), measured(c.limit, c), c.where) for c in found.checks
        )
        good, bad = sum(c.passed is True for c in found.checks), [c.name for c in found.failed]
        told = f"Verification passed: {good} checks of every file that optimize would write."
        if bad:
            told = f"VERIFICATION FAILED: {', '.join(bad)}."
        if left := [c.name for c in found.checks if c.passed is None]:
            told += f" Not run: {', '.join(left)}."
        answer = ViewAnswer(told=told, good=not bad, checks=rows)
        shown = [one for one in self.answers if one[0] is self.before]
        self.answers = [*shown, (self.now, answer)]
        return answer

    @property
    def _verification(self) -> ViewAnswer | None:
        """Of the plan shown."""
        return next((answer for plan, answer in self.answers if plan is self.now), None)

    @property
    def command(self) -> str:
        """What plans the same anew."""
        return " ".join(["machopt optimize", *self.words, "--plan", str(self.file)])

    def plan_text(self) -> str:
        """Every option of the plan shown as a plan file: YAML 1.2, of which JSON values are a part."""
        user = {"machopt_plan": 1, **options_as_user(self.now.given.options)}
        user.setdefault("steer", [])  # an empty list takes the place of one in cell.yaml
        lines = ["# yaml-language-server: $schema=plan.schema.json"]
        for key, value in user.items():
            if isinstance(value, list) and value:
                lines += [f"{key}:", *(f"  - {_flow(item)}" for item in value)]
            else:
                lines.append(f"{key}: {_flow(value)}")
        return "\n".join(lines) + "\n"

    def html(self) -> str:
        """The page: the report of the plan shown, and what steers it."""
        made, timings = self.now.made, self.now.timings
        data = report_data(
            made.plan,
            made.toolpath,
            made.points,
            made.timeline,
            None,
            shown=mapped(made.plan),
            blockers=made.production_blockers,
            before=None if self.before is None else self.before.made.plan,
            hashes=hashes_of(made.manifest.inputs),
            options=options_as_user(made.options),
            timings=timings.seconds,
        )
        return report_html(data, self._steering())

    def _options(self, wishes: dict[str, Any]) -> PlanOptions:
        unknown = sorted(set(wishes) - set(KEYS))
        if unknown:
            raise InputError(f"found {', '.join(unknown)}; {', '.join(KEYS)} can be set here", file="view")
        base = options_as_user(self.given.options)
        asked = {**base, **{k: wishes.get(k, base.get(k, [])) for k in KEYS}}
        if not asked["external"]:
            del asked["external"]
        options = load_options(**asked)
        if any(f.point >= len(self.given.toolpath) for f in options.fixed):
            raise InputError(f"the toolpath has points 0 to {len(self.given.toolpath) - 1}", file="view", where="fixed")
        steered(options, self.given.toolpath)
        refuse_narrow(options)
        axes_of(self.given.cell, options)
        return options

    def _steering(self) -> Steering:
        cell, toolpath = self.given.cell, self.given.toolpath
        candidates = self.now.made.plan.candidates
        labels = list(dict.fromkeys(o.label for o in toolpath.operations))
        parts = [(label, tuple(stretches(Steer(operation=label), toolpath))) for label in labels]
        return Steering(
            operations=tuple((label, points) for label, points in parts if points),
            points=len(toolpath),
            branches=candidates.q.shape[2] if candidates.stable else 0,
            axes=tuple(_axis(cell, k) for k in range(len(cell.external_joints))),
            wishes=self.wishes(),
            compared=compared(self.now.made, None if self.before is None else self.before.made),
            told=self.told,
            good=self.good,
            file=str(self.file),
            command=self.command,
            verified=None if (answer := self._verification) is None else answer.plain(),
        )


def _axis(cell: Cell, k: int) -> Axis:
    unit, per = ("mm", 1e3) if cell.external_prismatic[k] else ("deg", float(np.degrees(1.0)))
    low, high = (float(values[6 + k]) * per for values in (cell.limits.lower, cell.limits.upper))
    return Axis(cell.external_joints[k], unit, low, high)


def _outcome(made: Planned) -> tuple[str, bool]:
    """A sentence on what came of it, and whether there is a motion."""
    plan, timeline = made.made.plan, made.made.timeline
    seconds = sum(made.timings.seconds.values())
    if timeline is not None and timeline.trajectory is not None:
        return f"Planned in {seconds:.1f} s.", True
    if plan.conflict:
        return plan.conflict, False
    breaks = all_breaks(plan, timeline.obstructions if timeline else ())
    if breaks:
        return f"No continuous motion {breaks[0].where}: {breaks[0].text}.", False
    return ("No motion was found." if whole(plan) else "Some points have no posture; the page lists them."), False


def _flow(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
