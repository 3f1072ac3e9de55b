"""Options of every command that reads toolpath files: information that the file does not contain."""

from __future__ import annotations

import argparse
import math
from typing import Any

from machopt.cli.argument_errors import OptionParser
from machopt.errors import OptionError


def build_reading_parser() -> argparse.ArgumentParser:
    """Return a parent parser with the options."""
    p = OptionParser(add_help=False)
    p.add_argument("--unit", choices=("mm", "inch"), help="length unit of a file that states none")
    p.add_argument(
        "--machine", help="machine type that the rotary axes of the G-code are programmed for, e.g. table-ac, head-bc"
    )
    p.add_argument("--feed", type=float, metavar="MM_MIN", help="feed of cutting moves in a file that programs none")
    p.add_argument(
        "--tool-axis",
        metavar="AXIS",
        help="direction from tool tip to shank in the tool frame of robot programs and pose tables: -z (default), or "
        "--tool-axis=+z where the z axis of that frame points into the spindle",
    )
    p.add_argument(
        "--offset",
        action="append",
        default=[],
        metavar="NAME=X,Y,Z",
        help="position of a second work offset in the frame of the first one, mm, e.g. G55=100,0,0; may be repeated",
    )
    p.add_argument(
        "--decimals",
        type=int,
        metavar="N",
        help="number of decimal places of G-code numbers without a decimal point: with 4, X0019685 is 1.9685; with 0, "
        "X100 is 100",
    )
    p.add_argument(
        "--cycle-order",
        metavar="WORDS",
        help="meaning of the unnamed numbers of an APT CYCLE/ statement, e.g. depth,clear,retract",
    )
    p.add_argument(
        "--accept-unknown",
        action="append",
        default=[],
        metavar="WORD",
        help="ignore this unknown word of the file; only for words that move neither points nor frames (without this "
        "option unknown words stop the planning); may be repeated",
    )
    p.add_argument(
        "--kind",
        choices=("path", "holes"),
        help="meaning of the rows of a point table without a column kind: points of a path, or bottoms of holes with "
        "the columns depth_mm (below the surface) and approach_mm (start of the feed above the surface)",
    )
    p.add_argument("--max-extent", type=float, metavar="MM", help="largest plausible extent of a path (default: 50000)")
    p.add_argument("--strict", action="store_true", help="treat unknown words and truncated files as errors")
    return p


def convert_reading_options(args: argparse.Namespace) -> dict[str, Any]:
    """Return the keywords of :func:`machopt.toolpath.toolpath_reader.read_toolpath` that were given, SI.

    Args:
        args: The parsed command line.

    Raises:
        InputError: a number that cannot be.
    """
    if args.feed is not None and not args.feed > 0:
        raise OptionError(f"a feed of {args.feed:g} mm/min; more than zero would work", where="--feed")
    if args.max_extent is not None and not (math.isfinite(args.max_extent) and args.max_extent > 0):
        raise OptionError(f"an extent of {args.max_extent:g} mm; more than zero would work", where="--max-extent")
    feed = None if args.feed is None else args.feed / 60e3
    given_options = {
        "unit": args.unit,
        "machine": args.machine,
        "strict": args.strict or None,
        "default_feed": feed,
        "tool_axis": args.tool_axis,
        "kind": args.kind,
    }
    given: dict[str, Any] = {key: value for key, value in given_options.items() if value is not None}
    if args.offset:
        given["offsets"] = list(args.offset)
    if args.accept_unknown:
        given["accept_unknown"] = list(args.accept_unknown)
    if args.decimals is not None:
        given["decimals"] = args.decimals
    if args.cycle_order is not None:
        given["cycle_order"] = [w.strip() for w in args.cycle_order.split(",")]
    if args.max_extent is not None:
        given["max_extent"] = args.max_extent * 1e-3
    return given


def refuse_reading_options(args: argparse.Namespace, found: str) -> None:
    """Refuse every reading option where no toolpath is read.

    Args:
        args: The parsed command line.
        found: What the command reads instead.

    Raises:
        OptionError: names the first option that was given.
    """
    for key, value in vars(build_reading_parser().parse_args([])).items():
        if getattr(args, key) != value:
            raise OptionError(
                f"has no effect on {found}. Expected a call without it", where=f"--{key.replace('_', '-')}"
            )
