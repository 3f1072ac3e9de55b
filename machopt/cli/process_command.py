"""The command ``process``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machopt.cli.progress_display import ProgressDisplay, print_result
from machopt.cli.shared_options import add_shared_option

if TYPE_CHECKING:
    from machopt.data_types.documents.coefficients_document import CoefficientsDocument, WaveformSection

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the command to the parser.

    Args:
        commands: The sub-parsers of the main parser.
        common: Parent parser with the options of every command.
    """
    p = commands.add_parser("process", parents=[common], help="fit cutting-force coefficients to measured cuts")
    add_shared_option(p, "cell")
    p.add_argument("recording", type=Path, help="recording folder of kind cutting: mean forces or waveforms")
    for name in ("--out", "--force", "--allow-external", "--tables"):
        add_shared_option(p, name)
    p.add_argument("--material", default="", metavar="NAME", help="its name in process.yaml (the recording's folder)")
    p.add_argument("--level", type=float, default=90.0, metavar="PERCENT", help="of the intervals (90)")
    p.add_argument("--keep-outliers", action="store_true", help="no cut is put aside because of its residual")
    p.set_defaults(run=_run_process)


def _run_process(args: argparse.Namespace) -> int:
    from machopt.commands.process.run import run_process
    from machopt.measurement.cutting.request import ProcessRequest

    request = ProcessRequest(
        cell=args.cell,
        recording=args.recording,
        out=args.out,
        material=args.material,
        level_percent=args.level,
        keep_outliers=args.keep_outliers,
        allow_external=args.allow_external,
        tables=args.tables,
        overwrite=args.overwrite,
    )
    with ProgressDisplay(show=not (args.quiet or args.json)) as display:
        done = run_process(request, display.show_stage)
    if args.json:
        print_result(done.result)
    elif not args.quiet:
        print("\n".join(_format_summary(done.result)))
        print(f"report: {done.report}")
    return 0


def _format_summary(result: CoefficientsDocument) -> list[str]:
    lines = [
        f"{result.material}: {result.used} of {result.cuts} cuts used, "
        f"spread of a predicted mean force {result.spread_percent:.1f} %"
    ]
    for entry in result.coefficients:
        low, high = entry.interval
        text = "set to 0" if low is None or high is None else f"{low:.4g} … {high:.4g}"
        lines.append(f"  {entry.name}  {entry.value:8.4g} {entry.unit:6}  {text}")
    if result.waveform is not None:
        lines += _format_waveform(result.waveform)
    lines += [f"  left out: {entry.place}: {entry.reason}" for entry in result.excluded]
    return [*lines, *(f"  note: {text}" for text in result.warnings)]


def _format_waveform(section: WaveformSection) -> list[str]:
    lines = []
    if section.runout is not None:
        low, high = section.runout.interval_mm
        angle = section.runout.angle_deg
        text = "angle not determined" if angle is None else f"at {angle:.1f}° from tooth 0"
        lines.append(f"  run-out  {section.runout.amplitude_mm:.4f} mm  {low:.4f} … {high:.4f}, {text}")
    for cut in section.cuts:
        lines.append(
            f"  {cut.place}: {cut.spindle_rpm:.1f} rpm, tooth 0 at {cut.offset_deg:.2f} ± {cut.offset_sigma_deg:.2f}°"
        )
    return lines
