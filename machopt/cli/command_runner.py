"""Commands whose request has a field for every option."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from machopt.cli.progress_display import ProgressDisplay, print_result


def run_request_command(args: argparse.Namespace, request: Any, run: Any, renamed: dict[str, str]) -> int:
    """Run a command whose request has a field for every option, and print its result.

    Args:
        args: The parsed command line.
        request: Class of the request.
        run: Function that runs the request.
        renamed: Field of an option, where it is not the option's own name.

    Returns:
        The exit code.
    """
    from dataclasses import fields

    known = {f.name for f in fields(request)}
    given = {renamed.get(k, k): tuple(v) if isinstance(v, list) else v for k, v in vars(args).items()}
    with ProgressDisplay(show=not (args.quiet or args.json)) as display:
        done = run(request(**{k: v for k, v in given.items() if k in known}), display.show_stage)
    if args.json:
        print_result(done.result)
    notes = [f"  note: {w}" for w in done.result.warnings if w != done.message]
    if done.exit_code != 0:
        print(f"machopt: {done.message} (report: {done.report})", file=sys.stderr)
        print("\n".join(notes), end="\n" if notes else "", file=sys.stderr)  # often the cause
    elif not (args.quiet or args.json):
        print("\n".join([done.message, *notes, f"report: {done.report}"]))
    return int(done.exit_code)
