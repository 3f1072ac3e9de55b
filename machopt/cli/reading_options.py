"""Options of every command that reads toolpath files: information that the file does not contain."""

from __future__ import annotations

import argparse
import math
from typing import Any

from machopt.errors import OptionError


def build_reading_parser() -> argparse.ArgumentParser:
    """Return a parent parser with the options."""
    p = argparse.ArgumentParser(add_help=False)
    p.add_argument("--unit", choices=("mm", "inch"), help="length unit of a file that does not say")
    p.add_argument("--machine", help="kinematics behind rotary axes in G-code, e.g. table-ac, head-bc")
    p.add_argument("--feed", type=float, metavar="MM_MIN", help="feed of cutting moves in a file that has none")
    p.add_argument(
        "--tool-axis",
        metavar="AXIS",
        help="direction from tip to shank in the tool frame of robot programs and pose tables: -z (default), "
        "--tool-axis=+z where the frame's z points into the spindle",
    )
    p.add_argument(
        "--offset",
        action="append",
        default=[],
        metavar="NAME=X,Y,Z",
        help="where a further work offset of the program lies in its first one, mm, e.g. G55=100,0,0; may be repeated",
    )
    p.add_argument(
        "--decimals",
        type=int,
        metavar="N",
        help="G-code numbers without a decimal point count the N-th decimal (X0019685 is 1.9685 with 4); 0: as they "
        "stand",
    )
    p.add_argument(
        "--cycle-order",
        metavar="WORDS",
        help="what numbers without a word in an APT CYCLE/ stand for (depth,clear,retract)",
    )
    p.add_argument(
        "--accept-unknown",
        action="append",
        default=[],
        metavar="WORD",
        help="a word of the file that is not understood and moves neither points nor frames; without this option it "
        "stops a plan; may be repeated",
    )
    p.add_argument(
        "--kind",
        choices=("path", "holes"),
        help="what the rows of a point table without a column kind are: points of a path, or the bottoms of holes with "
        "columns depth_mm (surface to row) and approach_mm (above the surface, where the feed starts)",
    )
    p.add_argument("--max-extent", type=float, metavar="MM", help="largest extent of a path that is believed (50000)")
    p.add_argument("--strict", action="store_true", help="refuse words that are not understood, and files cut off")
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
    said = {
        "unit": args.unit,
        "machine": args.machine,
        "strict": args.strict or None,
        "default_feed": feed,
        "tool_axis": args.tool_axis,
        "kind": args.kind,
    }
    given: dict[str, Any] = {key: value for key, value in said.items() if value is not None}
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
