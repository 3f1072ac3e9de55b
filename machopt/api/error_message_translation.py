"""Errors of API functions name Python arguments, as errors of the command line name options."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from machopt.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")

RENAMED = {
    "--anchors": "anchors_mm",
    "--feed": "feed_mm_min",
    "--fit": "terms",
    "--keep-outliers": "robust",
    "--level": "level_percent",
    "--load-N": "force",
    "--memory-limit-mib": "memory_limit",
    "--no-studies": "studies",
    "--offset": "offsets",
    "--package": "packages",
    "--plan": "plan_file",
    "--post": "posts",
    "--prior": "prior_Nm_per_rad",
    "--range": "ranges",
    "--set": "overrides",
    "--step": "steps",
    "--time-limit-s": "time_limit",
    "--tracker": "tracker_mm",
    "--xacro-arg": "xacro_args",
}
"""Options whose argument is not the option's own name with underscores."""

_SETTING = re.compile(r"--set (?=\w+=)")  # of a planning option, which is an argument of its own
_OPTION = re.compile(r"(?<![\w-])(--[a-z][\w-]*)(?:[ =](?=-?[0-9]))?")


def use_argument_names(**own: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator: input errors of the function name its arguments where they named options.

    Args:
        own: Options of this function alone, as identifiers, e.g. ``effects="terms"``.

    Returns:
        The decorator; the function keeps its signature.
    """
    names = {**RENAMED, **{f"--{option.replace('_', '-')}": argument for option, argument in own.items()}}

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def call(*args: P.args, **keywords: P.kwargs) -> R:
            try:
                return function(*args, **keywords)
            except InputError as error:
                error.rename_options(lambda text: replace_option_names(text, names))
                raise

        return call

    return decorate


def replace_option_names(text: str, names: dict[str, str]) -> str:
    """Return a message with arguments in place of options: ``--pull-N 200`` becomes ``pull_N=200``.

    Args:
        text: Message of an error.
        names: Argument of an option, where it is not the option's own name.
    """

    def replace(found: re.Match[str]) -> str:
        option = found[1]
        name = names.get(option) or option.removeprefix("--").replace("-", "_")
        return f"{name}=" if found.end() > found.end(1) else name

    return _OPTION.sub(replace, _SETTING.sub("", text))
