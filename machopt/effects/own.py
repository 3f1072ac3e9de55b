"""Effects of a user's own, beside those of the registry: from a Python file, or from an installed package.

A file has ``EFFECTS``, a list of :class:`~machopt.effects.protocol.Effect`; a package names such a list as an entry
point in the group ``machopt.effects``. Either is code: loading it runs it, with all the rights of whoever started
machopt. A package offers its effects by being installed; a file is run only where the command line names it.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import entry_points
from os.path import isfile
from pathlib import Path
from types import ModuleType

from machopt.effects import registry
from machopt.effects.protocol import JOINTS, Effect
from machopt.errors import InputError

GROUP = "machopt.effects"
BROKEN = (  # what code of a user's own may raise
    ArithmeticError,
    AssertionError,
    AttributeError,
    ImportError,
    LookupError,
    NameError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)


@dataclass(frozen=True)
class Own:
    """A file of the user's, run."""

    file: Path
    module: ModuleType

    @property
    def has_effects(self) -> bool:
        return hasattr(self.module, "EFFECTS")


def run(files: Sequence[Path]) -> tuple[Own, ...]:
    """Run Python files.

    Raises:
        InputError: a file that is missing or does not run.
    """
    out = []
    for n, file in enumerate(files):
        if not isfile(file):
            raise InputError("there is no such file; a Python file would work", file=file)
        spec = importlib.util.spec_from_file_location(f"machopt_user_terms_{n}", file)
        if spec is None or spec.loader is None:
            raise InputError("is not a Python file", file=file)
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        try:
            spec.loader.exec_module(module)
        except (SyntaxError, *BROKEN) as problem:
            raise InputError(f"does not run: {type(problem).__name__}: {problem}", file=file) from problem
        out.append(Own(file, module))
    return tuple(out)


def with_effects(files: Sequence[Path]) -> tuple[Own, ...]:
    """Run Python files, each of which must have effects.

    Raises:
        InputError: a file that is missing, does not run or has none.
    """
    out = run(files)
    for own in out:
        if not own.has_effects:
            raise InputError("has no EFFECTS; a list of Effect objects would work", file=own.file)
    return out


@contextmanager
def in_use(own: Iterable[Own] = ()) -> Iterator[None]:
    """Within it the registry has the effects of these files, and of installed packages, beside its own.

    Raises:
        InputError: something that is no effect of single joints, or a name that is taken.
    """
    before = registry.EFFECTS
    offers = [(e.value, e.load()) for e in entry_points(group=GROUP)]
    offers += [(str(o.file), o.module.EFFECTS) for o in own if o.has_effects]
    known = list(before.values())
    for source, offered in offers:
        new = [e for e in _checked(offered, source) if before.get(e.name) is not e]
        try:
            registry.registry((*known, *new))
        except ValueError as taken:
            raise InputError(f"EFFECTS: {taken}; another name would work", file=source) from taken
        known += new
    registry.EFFECTS = registry.registry(known)
    try:
        yield
    finally:
        registry.EFFECTS = before


def _checked(offered: object, source: str) -> list[Effect]:
    if not isinstance(offered, list | tuple) or not offered:
        raise InputError(f"EFFECTS is {type(offered).__name__}; a list of Effect objects would work", file=source)
    for e in offered:
        if not isinstance(e, Effect):
            raise InputError(f"EFFECTS holds {type(e).__name__}; Effect objects would work", file=source)
        if not (e.laws and e.elastic and e.port == "twist" and set(e.places) <= set(JOINTS)):
            raise InputError(
                f"{e.name}: an elastic effect with laws, port twist and places joint:1 … joint:6 would work; for "
                "anything else hypotheses(readings) of machopt diagnose",
                file=source,
            )
    return list(offered)
