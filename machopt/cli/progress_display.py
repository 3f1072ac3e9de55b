"""Input and output helpers of every command: integers, the current stage, results as JSON, indented lines."""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from machopt.data_types.documents.document_base import DocumentModel

LAST_PORT = 65535  # TCP counts ports in 16 bits


class ProgressDisplay:
    """Display of the current stage: a live line on a terminal, else one line for each stage."""

    _WORDS: ClassVar[dict[str, str]] = {
        "load": "reading cell and toolpath",
        "prepare": "building kinematics and collision model",
        "candidates": "every branch, turn and rotation",
        "score": "stiffness of every candidate",
        "baselines": "CAM default and jiao2022",
        "choose": "best sequence for the whole path",
        "smooth": "smooth rotation",
        "check": "collisions",
        "compare": "comparing methods",
        "compensate": "shifting the path against the deflection",
        "joint": "rotation and feed together",
        "points": "stiffness and clearance per point",
        "retime": "feed, acceleration and jerk",
        "export": "trajectory, tables and program",
        "verify": "verifying with independent code",
        "report": "report",
    }

    def __init__(self, *, show: bool) -> None:
        self._status: Any = None
        self._last = ""
        self._show = show

    def __enter__(self) -> ProgressDisplay:
        if self._show and sys.stderr.isatty():
            from rich.console import Console

            self._status = Console(stderr=True).status("starting")
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def print_line(self, text: str) -> None:
        """Print a line that stays.

        Args:
            text: The line.
        """
        if self._status is not None:
            self._status.console.print(f"… {text}", highlight=False)
        elif self._show:
            print(f"… {text}", file=sys.stderr, flush=True)

    def show_stage(self, name: str) -> None:
        """Show the current stage.

        Args:
            name: Key of the stage.
        """
        words = self._WORDS.get(name, name)
        if self._status is not None:
            self._status.update(words)
        elif self._show and words != self._last:
            print(f"… {words}", file=sys.stderr, flush=True)
        self._last = words


def parse_natural_number(text: str) -> int:
    """Return a whole number from 0 on.

    Args:
        text: Text of the option.
    """
    return _parse_integer(text, 0)


def parse_port(text: str) -> int:
    """Return a TCP port, 0 for any that is free.

    Args:
        text: Text of the option.

    Raises:
        argparse.ArgumentTypeError: it is no port.
    """
    value = parse_natural_number(text)
    if value > LAST_PORT:
        raise argparse.ArgumentTypeError(f"found {text!r}; expected a port from 0 to {LAST_PORT}")
    return value


def parse_positive_integer(text: str) -> int:
    """Return a whole number from 1 on.

    Args:
        text: Text of the option.
    """
    return _parse_integer(text, 1)


def _parse_integer(text: str, least: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise argparse.ArgumentTypeError(f"found {text!r}; expected a whole number from {least} on")
    return value


def print_result(result: DocumentModel) -> None:
    """Print a result as one JSON object on one line of stdout.

    Args:
        result: The result document.
    """
    print(json.dumps(_replace_non_finite(result.to_json_types()), ensure_ascii=False))


def _replace_non_finite(value: Any) -> Any:
    """NaN and infinities as null, which JSON has no word for."""
    if isinstance(value, dict):
        return {k: _replace_non_finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_replace_non_finite(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.item() if hasattr(value, "item") else value


def format_as_tree(value: dict[str, Any], indent: int = 0) -> list[str]:
    """Return a dictionary as indented lines.

    Args:
        value: The dictionary.
        indent: Number of leading levels.
    """
    out = []
    pad = "  " * indent
    for key, item in value.items():
        if isinstance(item, dict):
            out += [f"{pad}{key}:", *format_as_tree(item, indent + 1)]
        elif isinstance(item, list | tuple) and item and isinstance(item[0], dict):
            out.append(f"{pad}{key}:")
            for row in item:
                out.append(f"{pad}  - " + ", ".join(f"{k} {_shorten_value(v)}" for k, v in row.items()))
        else:
            out.append(f"{pad}{key}: {_shorten_value(item)}")
    return out


def _shorten_value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return ", ".join(_shorten_value(v) for v in value) if value else "none"
    return str(value)
