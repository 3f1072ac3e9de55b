"""The command ``machopt``: parse, call, print. Heavy imports are delayed so that ``--help`` is fast."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import sys
from collections.abc import Sequence

import machopt
from machopt.cli import (
    batch_command,
    cell_commands,
    diagnose_command,
    garbage_collection,
    place_command,
    process_command,
    shell_completion,
    stiffness_commands,
    toolpath_commands,
    view_command,
)
from machopt.cli.argument_errors import OptionParser, list_commands
from machopt.cli.help_pages import ArrangedParser, arrange_help
from machopt.cli.shared_options import add_common_options, warn_of_unused_options
from machopt.errors import MachoptError
from machopt.version import __version__

BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: The arguments; None takes those of the process.

    Returns:
        The exit code: 0 done, 1 bug, 2 bad input, 3 infeasible, 4 verification failed.
    """
    garbage_collection.pause_garbage_collection()
    _replace_closed_streams()
    _limit_blas_threads()
    args = _build_parser().parse_args(argv)
    try:
        warn_of_unused_options(
            getattr(args, "idle_set", []), f"{args.command} plans nothing", quiet=getattr(args, "quiet", False)
        )
        code = int(args.run(args))
        sys.stdout.flush()  # a reader that has gone is noticed here, not at exit
        return code
    except MachoptError as error:
        if args.debug:
            raise
        print(f"machopt: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("machopt: stopped; nothing was written", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever read the output has gone; the job may not be finished, so this is not 0
        null = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                os.dup2(null, stream.fileno())
        return 141
    except MemoryError:
        print("machopt: the memory is not enough; a smaller job or more memory would work", file=sys.stderr)
        return 2
    except Exception as error:  # the last line of defence: a bug is one message, not a traceback
        if args.debug:
            raise
        print(
            f"machopt: internal error, please report it: {type(error).__name__}: {error} (--debug shows where)",
            file=sys.stderr,
        )
        return 1


def _limit_blas_threads() -> None:
    """BLAS on one thread, unless the user says otherwise: small matrices make its threads wait for each other.

    On a machine that is not idle they made a diagnosis three times as dear. Work is spread by ``model.threads``.
    """
    if "numpy" not in sys.modules and not any(name in os.environ for name in ("OMP_NUM_THREADS", *BLAS)):
        os.environ.update(dict.fromkeys(BLAS, "1"))


def _replace_closed_streams() -> None:
    """Streams that were closed by the caller swallow what is printed; a terminal without our letters shows escapes."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 — open as long as the program
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _build_parser() -> argparse.ArgumentParser:
    parser = ArrangedParser(prog="machopt", description=machopt.__doc__.splitlines()[0] if machopt.__doc__ else None)
    parser.add_argument("--version", action="version", version=f"machopt {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    common = OptionParser(add_help=False)
    common.add_argument("--quiet", action="store_true", help="print only errors")
    common.add_argument("--json", action="store_true", help="print the result as a JSON object")
    common.add_argument("--debug", action="store_true", help="show the Python traceback of an error")
    toolpath_commands.add_commands(commands, common)
    stiffness_commands.add_commands(commands, common)
    diagnose_command.add_commands(commands, common)
    process_command.add_commands(commands, common)
    place_command.add_commands(commands, common)
    batch_command.add_commands(commands, common)
    cell_commands.add_commands(commands, common)
    view_command.add_commands(commands, common)
    for name, command in list_commands(parser).items():
        add_common_options(command)
        arrange_help(name, command)
    shell_completion.add_commands(commands, parser)
    return parser
