"""The command ``diagnose``: differences of model and recording, and the missing effects."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machopt.cli.progress_display import ProgressDisplay, parse_natural_number, print_result
from machopt.cli.recording_preview_output import print_recording_preview
from machopt.cli.shared_options import add_shared_option, warn_of_unused_options

if TYPE_CHECKING:
    from machopt.data_types.documents.diagnosis_document import DiagnosisDocument, FindingEntry

Commands = Any  # argparse keeps its subparsers' type private

_VERDICTS = {
    "consistent": "consistent: nothing repeatable above the noise",
    "explained": "explained",
    "partly_explained": "explained in part",
    "unexplained": "not explained: a repeatable mismatch that no law of the catalogue predicts",
    "insufficient": "insufficient: no effect was found, and there are too few readings to conclude that none is "
    "missing",
}


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the command to the parser.

    Args:
        commands: The sub-parsers of the main parser.
        common: Parent parser with the options of every command.
    """
    p = commands.add_parser(
        "diagnose",
        parents=[common],
        help="find where the model differs from a recording and which physical effects explain it",
    )
    add_shared_option(p, "cell")
    p.add_argument(
        "recording", type=Path, nargs="+", help="recording folders, one for each session or run of the same robot"
    )
    add_shared_option(p, "--out")
    add_shared_option(p, "--force")
    p.add_argument(
        "--channel",
        choices=("auto", "torque", "link", "tip"),
        default="auto",
        help="quantity of a motion recording to compare: joint torque, difference of link-side and motor-side joint "
        "positions, or TCP position (default: auto, by the columns of the recording)",
    )
    p.add_argument(
        "--toolpath", type=Path, metavar="FILE", help="also report how the findings change the plan of this toolpath"
    )
    add_shared_option(p, "--set", help="set a planning option for the plans of --toolpath; may be repeated")
    p.add_argument(
        "--effects",
        type=Path,
        action="append",
        default=[],
        metavar="FILE.py",
        help="Python file with your own effects to test as well; RUNS the code in FILE.py with your rights, so give "
        "only files that you trust; may be repeated",
    )
    p.add_argument("--terms", dest="effects", type=Path, action="append", help=argparse.SUPPRESS)  # its name in 0.1
    p.add_argument(
        "--max-findings",
        type=parse_natural_number,
        metavar="N",
        help="largest number of findings (default: 3 for motions, 6 for load tests and poses); does not limit the "
        "explanation of measured poses with effects at more than four locations, unless N is 1 or 2",
    )
    add_shared_option(p, "--accept")
    add_shared_option(p, "--allow-external")
    add_shared_option(p, "--seed")
    add_shared_option(p, "--jobs")
    add_shared_option(p, "--tables")
    add_shared_option(p, "--dry-run")
    p.set_defaults(run=_run_diagnose)


def _run_diagnose(args: argparse.Namespace) -> int:
    from machopt.commands.diagnose.run import run_diagnose
    from machopt.measurement.diagnosis.request import DiagnoseRequest

    if args.dry_run:
        return print_recording_preview(args)
    if args.toolpath is None:
        warn_of_unused_options(args.set, "nothing is planned without --toolpath", quiet=args.quiet)
    request = DiagnoseRequest(
        cell=args.cell,
        recordings=tuple(args.recording),
        out=args.out,
        overwrite=args.overwrite,
        channel=args.channel,
        toolpath=args.toolpath,
        overrides=tuple(args.set),
        terms=tuple(args.effects),
        max_findings=args.max_findings,
        accept=tuple(args.accept),
        seed=args.seed,
        allow_external=args.allow_external,
        tables=args.tables,
    )
    if not args.quiet:
        for file in args.effects:
            print(f"machopt: --effects runs the code in {file} with your rights", file=sys.stderr)
    with ProgressDisplay(show=not (args.quiet or args.json)) as display:
        done = run_diagnose(request, display.show_stage)
    if args.json:
        print_result(done.result)
    elif not args.quiet:
        print("\n".join(format_diagnosis_summary(done.result)))
        print(f"report: {done.report}")
    return 0


def format_diagnosis_summary(result: DiagnosisDocument) -> list[str]:
    """Return the summary of diagnosis.json as lines for the terminal.

    Args:
        result: Content of diagnosis.json.
    """
    from machopt.effects.effect_wording import format_effect_at_place
    from machopt.effects.protocol import UNCATALOGUED

    unit = result.rmse_unit
    first, last = result.baseline, result.final
    lines = [
        result.sentence,
        f"  verdict: {_VERDICTS[result.verdict]}",
        f"  held-out error {_format_size(first.heldout_rmse, unit)} → {_format_size(last.heldout_rmse, unit)}, "
        f"noise floor "
        f"{_format_size(first.noise_floor, unit)}, repeatable {_format_size(first.repeatable_rmse, unit)}"
        + (f", {100 * last.explained_share:.0f} % of it closed" if last.explained_share is not None else ""),
    ]
    for number, f in enumerate(result.findings, 1):
        lines.append(f"  {number}. {_format_finding_name(f)}{f', {note}' if (note := f.note) else ''} ({f.law})")
        for name, p in f.parameters.items():
            low, high = p.ci90
            sure = f"   {_format_number(low)} … {_format_number(high)}" if low != high else ""
            lines.append(
                f"       {name.replace('_', ' ')} "
                f"{_format_number(p.value)}{'' if p.unit == '1' else f' {p.unit}'}{sure}"
            )
        lines.append(
            f"       held-out {_format_size(f.heldout_rmse_before, unit)} → "
            f"{_format_size(f.heldout_rmse_after, unit)}, "
            f"p {_format_number(f.p_value)}"
        )
        others = [
            format_effect_at_place(effect, location) if effect == UNCATALOGUED else f"{effect} {location}"
            for effect, location in f.one_of[1:]
        ]
        if others:
            lines.append(f"       these data cannot distinguish it from: {', '.join(others)}")
    if result.verdict in ("unexplained", "partly_explained"):
        where = sorted(result.mismatch, key=lambda s: -(s.share or 0.0))[:3]
        if where:
            lines.append(
                "  largest shares of the mismatch: "
                + ", ".join(f"{s.axis} {100 * (s.share or 0.0):.0f} %" for s in where)
            )
    if result.outliers is not None:
        count = len(result.outliers.rows)
        lines.append(f"  excluded: {count} reading{'' if count == 1 else 's'} ({result.outliers.location})")
    if result.effect_on_job is not None and result.effect_on_job.sentence:
        lines.append(f"  the job: {result.effect_on_job.sentence}")
    if result.next_experiment:
        lines.append(f"  next: {result.next_experiment}")
    return lines + [f"  note: {w}" for w in result.warnings]


def _format_finding_name(f: FindingEntry) -> str:
    return f"{f.effect} {f.location}"


def _format_number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _format_size(value: float | None, unit: str) -> str:
    if value is not None and unit == "mm" and abs(value) < 0.5:
        return f"{1e3 * value:.3g} µm"
    return f"{_format_number(value)} {unit}"
