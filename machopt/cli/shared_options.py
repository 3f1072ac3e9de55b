"""Options of several commands, each defined once, and the options of every command."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from machopt.cli.argument_errors import list_options
from machopt.cli.progress_display import parse_natural_number, parse_positive_integer
from machopt.file_formats.parquet_tables import KINDS


def parse_package_argument(text: str) -> tuple[str, Path]:
    """Return name and absolute folder of NAME=FOLDER.

    Args:
        text: Text of the option.

    Raises:
        argparse.ArgumentTypeError: another form, or no such folder.
    """
    name, mark, folder = text.partition("=")
    if not (name and mark and Path(folder).is_dir()):
        raise argparse.ArgumentTypeError(f"found {text!r}; expected NAME=FOLDER, a folder that is there")
    return name, Path(folder).absolute()


def parse_xacro_argument(text: str) -> tuple[str, str]:
    """Return name and value of NAME=VALUE; the value may be empty.

    Args:
        text: Text of the option.

    Raises:
        argparse.ArgumentTypeError: another form.
    """
    name, mark, value = text.partition("=")
    if not (name and mark):
        raise argparse.ArgumentTypeError(f"found {text!r}; expected NAME=VALUE")
    return name, value


class DryRunAction(argparse.Action):
    """Set the flag, and require no output folder: nothing is written."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *_: object) -> None:
        setattr(namespace, self.dest, True)
        for action in parser._actions:
            if action.dest == "out":
                action.required = False


SHARED: dict[str, dict[str, Any]] = {
    "cell": {"type": Path, "help": "folder of the cell, or its cell.yaml"},
    "toolpath": {"type": Path, "help": "CAM file or point table"},
    "--dry-run": {
        "action": DryRunAction,
        "nargs": 0,
        "default": False,
        "help": "print how each column is understood, and the residuals of the cell's own model; compute and write "
        "nothing (-o is not needed)",
    },
    "--out": {"flags": ("-o",), "type": Path, "required": True, "help": "output folder"},
    "--force": {
        "dest": "overwrite",
        "action": "store_true",
        "help": "overwrite files that machopt did not write or that were edited since",
    },
    "--allow-external": {"action": "store_true", "help": "allow the cell to use files outside its folder"},
    "--package": {
        "type": parse_package_argument,
        "action": "append",
        "default": [],
        "metavar": "NAME=FOLDER",
        "help": "folder of a ROS package that the robot file names (default: searched next to the file and above it); "
        "may be repeated",
    },
    "--xacro-arg": {
        "type": parse_xacro_argument,
        "action": "append",
        "default": [],
        "metavar": "NAME=VALUE",
        "help": "value of an argument of the xacro file; may be repeated",
    },
    "--seed": {
        "type": parse_natural_number,
        "default": 0,
        "help": "seed of the random numbers (default: 0); the same input and seed give the same files",
    },
    "--jobs": {"type": parse_positive_integer, "default": 1, "metavar": "N", "help": argparse.SUPPRESS},
    "--plan": {"type": Path, "metavar": "FILE", "help": "YAML file with planning options"},
    "--set": {
        "action": "append",
        "default": [],
        "metavar": "KEY=VALUE",
        "help": "set a planning option (docs/reference.md lists them); may be repeated",
    },
    "--post": {"action": "append", "default": [], "metavar": "POST"},
    "--program-tolerance-mm": {
        "type": float,
        "metavar": "MM",
        "help": "largest distance between the planned motion and the lines of the robot program; points are added "
        "until it is met (default: 0.05 mm)",
    },
    "--tables": {
        "choices": KINDS,
        "default": "csv",
        "help": "parquet: also write every table as a Parquet file (default: csv)",
    },
    "--effects": {
        "type": Path,
        "action": "append",
        "default": [],
        "metavar": "FILE.py",
        "help": "Python file that defines your own effects (see docs/diagnose.md), needed where stiffness.yaml or "
        "kinematics.yaml names one of them; runs the code in the file; may be repeated",
    },
    "--process": {
        "type": Path,
        "metavar": "FILE",
        "help": "process.yaml with cutting conditions, coefficients and tolerances, in place of the cell's own",
    },
    "--accept": {
        "action": "append",
        "default": [],
        "metavar": "CODE",
        "help": "report this error of the recording as a warning and continue; may be repeated",
    },
}
"""Name → keywords of argparse; ``flags`` are further names."""

_IDLE: dict[str, dict[str, Any]] = {
    "--seed": {"dest": "idle_seed", "help": argparse.SUPPRESS},
    "--jobs": {"dest": "idle_jobs"},
    "--set": {"dest": "idle_set", "help": argparse.SUPPRESS},
}
"""Common options that a command without use for them accepts and does not offer: no help shows them."""


def add_shared_option(parser: argparse._ActionsContainer, name: str, **changed: object) -> None:
    """Add a shared option to a parser.

    Args:
        parser: The argument parser.
        name: Name of the option.
        changed: Argparse keywords that this command overrides.
    """
    keywords: dict[str, Any] = {**SHARED[name], **changed}
    parser.add_argument(*keywords.pop("flags", ()), name, **keywords)


def add_common_options(parser: argparse.ArgumentParser) -> None:
    """Add the common options that the parser lacks, so that scripts can pass the same options to every command.

    Args:
        parser: The argument parser.
    """
    known = list_options(parser)
    for name, changed in _IDLE.items():
        if name not in known:
            add_shared_option(parser, name, **changed)


def warn_of_unused_options(words: list[str], why: str, *, quiet: bool) -> None:
    """Check planning options that a command does not use, and name them on stderr.

    Args:
        words: The options as NAME=VALUE.
        why: Why they have no effect.
        quiet: Print nothing.

    Raises:
        InputError: no planning option, or not a value of it.
    """
    if not words:
        return
    from machopt.options.plan_option_reader import load_options

    load_options(overrides=words)
    if not quiet:
        print(f"machopt: --set {' '.join(words)} has no effect: {why}", file=sys.stderr)
