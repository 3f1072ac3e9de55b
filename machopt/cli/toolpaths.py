"""The commands about toolpaths: ``optimize``, ``inspect``, ``verify``."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machopt.cli.compiling import compiling
from machopt.cli.display import Display, finite, tree
from machopt.cli.effects import add_effects, told_of_effects
from machopt.cli.readingoptions import reading, reading_parser
from machopt.cli.shared import share
from machopt.domain.manifest import with_scope
from machopt.errors import InputError, VerificationError

if TYPE_CHECKING:
    from machopt.domain.results.optimize import BreakTold, CheckTold, ChoiceObjective, CompensationTold, OptimizeResult
    from machopt.verify import Check

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the commands to the parser."""
    planning = argparse.ArgumentParser(add_help=False)
    share(planning, "--plan")
    share(planning, "--set")
    share(planning, "--allow-external")

    job = commands.add_parser(
        "optimize",
        parents=[common, reading_parser(), planning],
        help="the main job: the stiffest smooth trajectory for a toolpath",
    )
    share(job, "cell")
    share(job, "toolpath")
    share(job, "--out")
    job.add_argument("--method", choices=("global", "jiao2022", "default"))
    job.add_argument("--index", choices=("auto", "deflection", "stiffness", "jiao2022"))
    job.add_argument(
        "--allow-gaps", action="store_true", default=None, help="plan the rest where points are unreachable"
    )
    job.add_argument(
        "--compensate",
        action="store_true",
        default=None,
        help="shift the commanded path against the deflection predicted under force_N",
    )
    share(
        job,
        "--post",
        help="robot program to write: krl, rapid, fanuc, urscript, val3, jbi, csv, json, ros, … or a template file; "
        "may be repeated (the cell's controller.post; without either no robot program is written)",
    )
    share(job, "--program-tolerance-mm")
    job.add_argument(
        "--map-collisions",
        choices=("chosen", "full"),
        default="chosen",
        help="full: for the report's map, look for collisions of every configuration, for half a minute at most "
        "(chosen: only what the choice had to look at)",
    )
    job.add_argument(
        "--front",
        action="store_true",
        help="plan up to five times more, with other weights and clearance: stiffness against cycle time, joint "
        "travel and clearance: front.csv, and a section of the report",
    )
    job.add_argument("--sample-ms", type=float, help="time between exported samples (12)")
    share(job, "--seed", default=None, help="of the random search around obstacles")
    share(job, "--jobs", help="accepted for scripts; one plan runs in one process")
    add_effects(job)
    job.set_defaults(run=_optimize)

    look = commands.add_parser(
        "inspect",
        parents=[common, reading_parser()],
        help="what a CAM file holds: points, operations, feeds, words not understood; or a cell or robot: joints, "
        "limits and who sets them, mounting, pairs that may touch",
    )
    look.add_argument("file", type=Path)
    look.add_argument("--html", type=Path, metavar="OUT.html", help="write a page with pictures of the path")
    look.add_argument("--cell", type=Path, help="cell whose robot a program with joint positions was written for")
    share(look, "--allow-external")
    look.set_defaults(run=_inspect)

    check = commands.add_parser(
        "verify",
        parents=[common, reading_parser(), planning],
        help="re-check an exported trajectory with independent code",
    )
    share(check, "cell", help=None)
    share(check, "toolpath", help=None)
    check.add_argument("out", type=Path, help="output folder of optimize")
    check.set_defaults(run=_verify)


def _optimize(args: argparse.Namespace) -> int:
    from machopt.services.load import Request
    from machopt.services.run import optimize

    direct = {
        "method": args.method,
        "index": args.index,
        "allow_gaps": args.allow_gaps,
        "compensate": args.compensate,
        "sample_ms": args.sample_ms,
        "seed": args.seed,
    }
    request = Request(
        cell=args.cell,
        toolpath=args.toolpath,
        out=args.out,
        plan_file=args.plan,
        overrides=tuple(args.set),
        direct=direct,
        reading=reading(args),
        allow_external=args.allow_external,
        posts=tuple(args.post),
        program_tolerance_mm=args.program_tolerance_mm,
        front=args.front,
        map_all=args.map_collisions == "full",
        effects=tuple(args.effects),
    )
    told_of_effects(args)
    with Display(show=not (args.quiet or args.json)) as display, compiling(display):
        outcome = optimize(request, display.stage)
    if args.json:
        print(json.dumps(finite(outcome.result.plain()), ensure_ascii=False))
    elif not args.quiet:
        for line in _summary(outcome.result, outcome.report):
            print(line)
    if outcome.exit_code == 3:
        print(
            f"machopt: no feasible answer; {_first_reason(outcome.result)} ({outcome.report} lists every point)",
            file=sys.stderr,
        )
        told = outcome.result.warnings  # often the cause: a frame in metres, a body that is missing
        for warning in told[:3]:
            print(f"  note: {warning}", file=sys.stderr)
    elif outcome.exit_code == VerificationError.exit_code:
        print(f"machopt: verification failed: {_failed(outcome.result)}", file=sys.stderr)
    return outcome.exit_code


def _inspect(args: argparse.Namespace) -> int:
    from machopt.formats.inspect import summarise
    from machopt.formats.toolpath import read_toolpath

    if _is_robot(args.file):
        return _inspect_robot(args)
    if args.cell is None:
        toolpath = read_toolpath(args.file, **reading(args))
    else:
        from machopt.formats.cell import load_cell
        from machopt.formats.setups import placed
        from machopt.services.knownrobot import reading_of

        cell = load_cell(args.cell, allow_external=args.allow_external)
        toolpath = placed(read_toolpath(args.file, **reading_of(cell), **reading(args)), cell)
    summary = summarise(toolpath)
    if args.html is not None:
        from machopt.report.toolpath_page import write_toolpath_page

        try:
            write_toolpath_page(args.html, toolpath, summary)
        except OSError as problem:
            raise InputError(f"cannot be written: {problem.strerror}", file=args.html) from None
    if args.json:
        print(json.dumps(finite(summary), ensure_ascii=False))
    elif not args.quiet:
        print("\n".join(tree(summary)))
        if args.html is not None:
            print(f"pictures: {args.html}")
    return 0


def _is_robot(path: Path) -> bool:
    """A cell's folder, its cell.yaml, a URDF or a xacro file; everything else is read as a toolpath."""
    if path.is_dir():
        return (path / "cell.yaml").exists()
    return path.name == "cell.yaml" or path.suffix.lower() in (".urdf", ".xacro")


def _inspect_robot(args: argparse.Namespace) -> int:
    from machopt.services.look import look

    if args.html is not None:
        raise InputError("pictures are drawn of toolpaths; a cell is told without --html", where="--html")
    found = look(args.file, allow_external=args.allow_external)
    if args.json:
        print(json.dumps(finite(found), ensure_ascii=False))
    elif not args.quiet:
        print("\n".join(tree(found)))
    return 0


def _verify(args: argparse.Namespace) -> int:
    from machopt.cli.failures import causes_first, failures
    from machopt.recheck.inforce import Request
    from machopt.services.verify import verify

    done = verify(
        Request(
            cell=args.cell,
            toolpath=args.toolpath,
            out=args.out,
            plan_file=args.plan,
            overrides=tuple(args.set),
            reading=reading(args),
            allow_external=args.allow_external,
        )
    )
    found = done.verification
    if args.json:
        checks = [vars(c) for c in found.checks]
        value = {
            "passed": found.ok,
            "verdict": done.line,
            "samples": found.samples,
            "duration_s": found.duration,
            "notes": done.notes,
            "checks": checks,
        }
        print(json.dumps(finite(value), ensure_ascii=False))
    elif not args.quiet:
        print("\n".join(_check_line(c) for c in causes_first(found.checks)))
        print("\n".join([*(f"note: {n}" for n in done.notes), *([done.line] if found.ok else [])]))
    if not found.ok:
        raise VerificationError(f"{done.line}: {failures(found.checks)}")
    return done.exit_code


def _check_line(c: Check) -> str:
    if c.passed is None:
        return f"–    {c.name}: not run, {c.where}"
    where = "" if c.passed or not c.where else f" at {c.where}"
    if c.passed is False and c.limit == 0.0:
        return f"FAIL {c.name}: {c.where}"
    if math.isnan(c.value) and math.isnan(c.limit):
        return f"{'ok  ' if c.passed else 'FAIL'} {c.name}{where.replace(' at ', ': ', 1)}"
    return f"{'ok  ' if c.passed else 'FAIL'} {c.name}: {c.value:.4g} {c.unit} (limit {c.limit:.4g}){where}"


def _summary(result: OptimizeResult, report: Path) -> list[str]:
    """What a process engineer wants to read first."""
    path, objective = result.toolpath, result.objective
    lines = [
        f"{result.verdict}: {path.cutting_points} cutting points of {path.points}, "
        f"{len(path.operations)} operations, {path.format}"
    ]
    for name in ("cam_default", "jiao2022", "chosen"):
        o: ChoiceObjective = getattr(objective, name)
        if o.total is None:
            lines.append(f"  {name:12} not feasible throughout ({100 * o.feasible_share:.0f} % of the points)")
        else:
            mean, worst = (_in_words(result, cost) for cost in (o.mean, o.worst))
            lines.append(f"  {name:12} mean {mean}, worst {worst}   (objective {o.total:.3f})")
    lines += _gain_lines(result)
    lines += _certificate_lines(result)
    if result.front:
        free = [p.plan for p in result.front if not p.dominated]
        lines.append(f"  front of {len(free)} plans in front.csv: {', '.join(free)}")
    soft = result.worst_point
    if soft:
        bend = "" if soft.deflection_mm is None else f", deflection {soft.deflection_mm:.3f} mm"
        lines.append(
            f"  worst point {soft.point}: {_nan(soft.k_axial_N_mm):.0f} N/mm along the tool, "
            f"{_nan(soft.k_normal_N_mm):.0f} N/mm across{bend}"
        )
    shift = result.compensation
    if shift:
        lines.append(
            f"  compensated by up to {shift.max_mm:.3f} mm (mean {shift.mean_mm:.3f}); predicted to leave "
            f"{shift.residual_mean_mm:.4f} mm on average, {shift.residual_max_mm:.4f} at worst"
        )
        lines += _removed_lines(shift)
    if result.cycle_time_s is not None and result.feed_held_share is not None:
        dips = len(result.feed_dips)
        lines.append(
            f"  {result.cycle_time_s:.1f} s cycle, programmed feed held for "
            f"{100 * result.feed_held_share:.1f} % of the cutting time" + (f", {dips} dips" if dips else "")
        )
    for stop in result.obstructions:
        lines.append(f"  stopped: {stop.reason}")
    unknown = [w for w in path.ignored if not w.understood]
    if unknown:
        words = ", ".join(f"{w.word} ×{w.count} (line {w.first_line})" for w in unknown[:6])
        lines.append(f"  not understood in the CAM file: {words}{' …' if len(unknown) > 6 else ''}")
    lines += [f"  note: {w}" for w in result.warnings[:6]]
    lines += _programs(result)
    if result.verification is not None:
        passed = "passed" if result.verification.passed else "FAILED"
        lines.append("  " + with_scope(f"verification {passed}", result.unchecked))
    lines.append(f"report: {report}")
    return lines


def _removed_lines(shift: CompensationTold) -> list[str]:
    """What the model's own error makes of it, where that is known."""
    r = shift.removed
    if r is None or r.removed_ci90_percent is None or r.residual_max_ci90_mm is None:
        return []
    low, high = r.removed_ci90_percent
    least, most = r.residual_max_ci90_mm
    text = f"    {low:.1f} to {high:.1f} % of the mean deflection removed".replace("-", "−")
    return [f"{text} (90 %), {least:.4f} to {most:.4f} mm left at worst"]


def _gain_lines(result: OptimizeResult) -> list[str]:
    """The gain of the mean over each yardstick, with its uncertainty where the stiffness file has one."""
    what = "mean deflection" if result.index == "deflection" else "mean compliance"
    lines = []
    for gain in result.objective.gain:
        if gain.mean_percent is None or gain.over == result.chosen_from:
            continue
        share, std = gain.mean_percent, gain.std_percent
        if std is None and not gain.distinguishable:
            lines.append(f"  no gain over {gain.over}: the same {what}")
            continue
        decimals = int(abs(share) < 10 if std is None else std < 1.5)
        text = f"  gain over {gain.over}: {what} {abs(share):.{decimals}f} %"
        if std is None:
            lines.append(f"{text} {'less' if share >= 0 else 'more'}")
            continue
        low, high = sorted(_nan(v) if share >= 0 else -_nan(v) for v in gain.ci90 or ())
        text += f" ± {std:.{decimals}f} % {'less' if share >= 0 else 'more'}"
        lines.append(f"{text} (90 %: {low:.{decimals}f} to {high:.{decimals}f} %)")
        if not gain.distinguishable:
            lines.append("    less than rounding or the stiffness model's own uncertainty: not distinguishable")
    return lines


def _certificate_lines(result: OptimizeResult) -> list[str]:
    """How far from the best the plan can be, on the grid of rotations that was searched."""
    search, step = result.objective.search, result.options["rotation_step_deg"]
    if search is None:
        return []
    total, beyond = _nan(result.objective.chosen.total), search.beyond_grid_percent
    return [
        f"  objective {total:.4f}; no sequence on the {step:g}° grid is below {search.lower_bound:.4f} (found "
        f"{search.sequence:.4f}, gap {search.gap_percent:.2f} %), the smooth curve off the "
        f"grid {abs(beyond):.2f} % {'below' if beyond >= 0 else 'above'} that sequence"
    ]


def _in_words(result: OptimizeResult, cost: float | None) -> str:
    """A cost of the objective as the engineer reads it: deflection in mm, or stiffness in N/mm."""
    value = _nan(cost) * _nan(result.index_scale)
    if result.index == "deflection":
        return f"deflection {1e3 * value:.3f} mm"
    return f"stiffness {1e-3 / value:.0f} N/mm"


def _first_reason(result: OptimizeResult) -> str:
    """The first places where it fails, and what would help there."""
    points, breaks = result.infeasible_points, result.breaks
    parts = []
    if points:
        number = f"{len(points)} points" if len(points) > 1 else "1 point"
        parts.append(f"{number}, the first is {points[0].point}: {points[0].reason}")
    if breaks:
        number = f"{len(breaks)} breaks" if len(breaks) > 1 else "1 break"
        parts.append(f"{number}, the first {between(breaks[0])}: {breaks[0].reason}")
    told = (points or breaks)[:1]
    return "; ".join(parts) + (f"; {told[0].help}" if told else "")


def between(one: BreakTold) -> str:
    """The two ends of a break in words."""
    ends = ("home" if k is None else f"point {k:g}" for k in (one.from_point, one.to_point))
    return "from {} to {}".format(*ends)


def _programs(result: OptimizeResult) -> list[str]:
    """One line a robot program: where it is and what came back when it was read."""
    lines = []
    if not result.programs and result.exit_code == 0:
        lines.append("  no robot program: the cell names no controller.post and no --post was given, e.g. --post krl")
    for p in result.programs:
        c = p.checked
        if p.withheld:
            lines.append(f"  program for {p.post} withheld: {p.withheld}")
            continue
        if c is None:
            lines.append(f"  program {p.files[0]}: NOT CHECKED: in a language that no reader here knows")
        else:
            state = f"reads back within {_nan(c.positions_max_mm):.1g} mm"
            if p.differences:
                state = "DOES NOT READ BACK AS WRITTEN"
            if c.path_max_mm is not None:
                state += f", its lines keep to the motion within {c.path_max_mm:.3f} mm"
            added = f" ({p.moves_added} added for that)" if p.moves_added else ""
            lines.append(f"  program {p.files[0]}: {c.moves} moves{added}, {state}")
        feed = p.feed_model
        if feed is not None:
            lines.append(
                f"    by the model of its controller it holds {feed.mean_percent:.0f} % of the programmed feed "
                f"({feed.lowest_percent:.0f} % in the slowest move, {feed.exact_stops} exact stops), rounding "
                f"points by {feed.rounding_max_mm:.3f} mm at most"
            )
        lines += [f"    WARNING: {text}" for text in p.not_in_program]
        lines += [f"    assumed: {text}" for text in p.assumed]
    return lines


def _failed(result: OptimizeResult) -> str:
    from machopt.cli.failures import failures

    checks = result.verification.checks if result.verification else []
    return failures([_checked(c) for c in checks])


def _checked(c: CheckTold) -> Check:
    from machopt.verify import Check

    return Check(c.name, c.passed, _nan(c.value), _nan(c.limit), c.unit, c.where)


def _nan(value: float | None) -> float:
    """A number of a result file, where null stands for what is not finite."""
    return math.nan if value is None else value
