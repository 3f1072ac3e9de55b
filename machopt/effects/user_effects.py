"""User-defined effects in addition to those of the registry, from a Python file or an installed package.

A file defines ``EFFECTS``, a list of :class:`~machopt.effects.protocol.Effect`. A package names such a list as an
entry point in the group ``machopt.effects``. Both are code that runs with the user's rights when it is loaded. A
package is active when it is installed. A file is run only if the command line names it.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from os.path import isfile
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from machopt.data_types.effect_locations import MOST_JOINTS, format_joint_pair_location, format_link_location
from machopt.effects import registry
from machopt.effects.protocol import (
    JOINTS,
    BodyLaw,
    CompliantBody,
    Effect,
    JointAngleLaw,
    JointAngleRange,
    JointLoading,
    JointLoadRange,
)
from machopt.errors import EffectDefinitionError

GROUP = "machopt.effects"
PAIRS = tuple(
    format_joint_pair_location(i, j) for i in range(1, MOST_JOINTS + 1) for j in range(i + 1, MOST_JOINTS + 1)
)
BODIES = (*(format_link_location(i) for i in range(1, MOST_JOINTS + 1)), "base", "tool")
USER_CODE_ERRORS = (
    Exception,
    SystemExit,
)  # errors that user code may raise; an uncaught sys.exit would end the command silently


@dataclass(frozen=True)
class UserModule:
    """Loaded Python file of the user."""

    file: Path
    module: ModuleType

    @property
    def has_effects(self) -> bool:
        return hasattr(self.module, "EFFECTS")


def run_user_files(files: Sequence[Path]) -> tuple[UserModule, ...]:
    """Run Python files as modules.

    Args:
        files: Paths of the files.

    Returns:
        The loaded modules.

    Raises:
        InputError: A file is missing or does not run.
    """
    out = []
    for n, file in enumerate(files):
        if not isfile(file):
            raise EffectDefinitionError("there is no such file; a Python file would work", file=file)
        spec = importlib.util.spec_from_file_location(f"machopt_user_terms_{n}", file)
        if spec is None or spec.loader is None:
            raise EffectDefinitionError("is not a Python file", file=file)
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        try:
            spec.loader.exec_module(module)
        except USER_CODE_ERRORS as problem:
            raise EffectDefinitionError(f"does not run: {type(problem).__name__}: {problem}", file=file) from problem
        out.append(UserModule(file, module))
    return tuple(out)


def load_effect_files(files: Sequence[Path]) -> tuple[UserModule, ...]:
    """Run Python files that must define effects.

    Args:
        files: Paths of the files.

    Returns:
        The loaded modules.

    Raises:
        InputError: A file is missing, does not run or defines no effects.
    """
    out = run_user_files(files)
    for own in out:
        if not own.has_effects:
            raise EffectDefinitionError("has no EFFECTS; a list of Effect objects would work", file=own.file)
    return out


@contextmanager
def activate_user_effects(own: Iterable[UserModule] = ()) -> Iterator[None]:
    """Add user-defined effects to the registry inside a ``with`` block, including those of installed packages.

    Args:
        own: Loaded modules of the user.

    Raises:
        InputError: An invalid effect, or a name that is already in use.
    """
    before = registry.EFFECTS
    offers = find_entry_points(GROUP)
    offers += [(str(o.file), o.module.EFFECTS) for o in own if o.has_effects]
    known = list(before.values())
    for source, offered in offers:
        new = [e for e in _check_effects(offered, source) if before.get(e.name) is not e]
        for e in new:
            _refuse_taken(e, known, source)
        try:
            registry.build_registry((*known, *new))
        except ValueError as taken:
            raise EffectDefinitionError(f"EFFECTS: {taken}; another name would work", file=source) from taken
        known += new
    registry.EFFECTS = registry.build_registry(known)
    try:
        yield
    finally:
        registry.EFFECTS = before


def find_entry_points(group: str) -> list[tuple[str, Any]]:
    """Load what installed packages offer in an entry-point group.

    Args:
        group: Name of the entry-point group.

    Returns:
        For each entry point its source and the loaded object.

    Raises:
        InputError: A package does not load.
    """
    out = []
    for e in _list_entry_points(group, tuple((place, _get_change_time(place)) for place in sys.path)):
        try:
            out.append((e.value, e.load()))
        except USER_CODE_ERRORS as problem:
            raise EffectDefinitionError(
                f"an installed package offers this in {group}, and it does not load: "
                f"{type(problem).__name__}: {problem}; without the package, or with it repaired, it would work",
                file=e.value,
            ) from problem
    return out


@lru_cache(maxsize=8)  # reading the metadata of all installed packages takes longer than a short verification
def _list_entry_points(group: str, _path: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=group))


def _get_change_time(place: str) -> int:
    """Return the time in ns at which an entry of sys.path changed last; 0 where it does not exist."""
    try:
        return Path(place or ".").stat().st_mtime_ns
    except OSError:
        return 0


def _refuse_taken(e: Effect, known: Iterable[Effect], source: str) -> None:
    for other in known:
        shared = {e.name, e.file_word} & {other.name, other.file_word}
        if shared:
            raise EffectDefinitionError(
                f"EFFECTS: {shared.pop()!r} is the name of another effect; another name would work", file=source
            )


def _check_effects(offered: object, source: str) -> list[Effect]:
    if not isinstance(offered, list | tuple) or not offered:
        raise EffectDefinitionError(
            f"EFFECTS is {type(offered).__name__}; a list of Effect objects would work", file=source
        )
    for e in offered:
        if not isinstance(e, Effect):
            raise EffectDefinitionError(f"EFFECTS holds {type(e).__name__}; Effect objects would work", file=source)
        of_joint = e.joint_laws and not e.body_laws and e.port == "twist" and set(e.places) <= set(JOINTS)
        of_body = e.body_laws and not e.joint_laws and e.port == "body" and set(e.places) <= set(BODIES)
        of_angle = e.angle_laws and not e.is_elastic and e.port == "angle" and set(e.places) <= {*JOINTS, *PAIRS}
        if not (e.places and ((e.is_elastic and (of_joint or of_body)) or of_angle)):
            raise EffectDefinitionError(
                f"{e.name}: an elastic effect with laws, port twist and places joint:1 … joint:6 would work, or one "
                "that gives, port body and places link:1 … link:6, base, tool, or one that is not elastic, unloaded, "
                "port angle and places joint:1 … joint:6 or joint:4-5; for anything else hypotheses(readings) of "
                "machopt diagnose",
                file=source,
            )
        for law in e.joint_laws:
            _try_joint_law(e, law, source)
        for body in e.body_laws:
            _try_body_law(e, body, source)
        for angle in e.angle_laws:
            _try_angle_law(e, angle, source)
    return list(offered)


def _try_body_law(e: Effect, law: BodyLaw, source: str) -> None:
    """Evaluate the law of a compliant body once and check its outputs."""
    body = CompliantBody(axes=np.eye(3), length=0.5, root=np.eye(4), normal=np.array([0.0, 0.0, 1.0]))
    name = f"{e.name}: law {getattr(law, 'name', type(law).__name__)!r}"
    try:
        shape = np.array((law.grid(body) or ((),))[0], float)
        answer = np.asarray(law.matrices(shape, body), float)
        count = len(law.coefficients)
        law.sizes(np.ones(count), shape)
        law.to_file_parameters(np.ones(count), shape, body)
        law.restrict_to_observed(6, turning=True).axes(body)
    except USER_CODE_ERRORS as problem:
        raise EffectDefinitionError(
            f"{name} does not run: {type(problem).__name__}: {problem}", file=source
        ) from problem
    if answer.shape != (count, 6, 6) or not count or not np.isfinite(answer).all():
        raise EffectDefinitionError(
            f"{name}: matrices have the shape {answer.shape} (or NaN); finite ({max(count, 1)}, 6, 6) would work",
            file=source,
        )


def _try_angle_law(e: Effect, law: JointAngleLaw, source: str) -> None:
    """Evaluate an angle law and its three derivatives once and check the outputs."""
    q = np.array([-0.5, 0.1, 0.7])
    name = f"{e.name}: law {getattr(law, 'name', type(law).__name__)!r}"
    try:
        shape = np.array((law.grid(JointAngleRange(-1.0, 1.0, 20)) or (tuple(p.factor for p in law.shape),))[0], float)
        answers = [np.asarray(law.columns(shape, q, n), float) for n in range(4)]
        values = np.ones(answers[0].shape[-1])
        law.sizes(values, shape)
        bounds = float(law.compute_max_slope(values, shape)), float(law.compute_max_error(values, shape))
        texts = (law.name, law.equation, law.note, law.word, law.sum_name)
        certain = float(law.penalty), law.prior is None or float(law.prior)
    except USER_CODE_ERRORS as problem:
        raise EffectDefinitionError(
            f"{name} does not run: {type(problem).__name__}: {problem}", file=source
        ) from problem
    if not all(isinstance(text, str) for text in texts) or np.isnan((*bounds, *certain)).any():
        raise EffectDefinitionError(f"{name}: texts, and bounds and penalty that are numbers, would work", file=source)
    for n, answer in enumerate(answers):
        if answer.ndim != 2 or len(answer) != len(q) or not answer.shape[1] or not np.isfinite(answer).all():
            raise EffectDefinitionError(
                f"{name}: columns of derivative {n} at {len(q)} angles have the shape {answer.shape} (or NaN); finite "
                f"({len(q)}, p) would work",
                file=source,
            )


def _try_joint_law(e: Effect, law: Any, source: str) -> None:
    """Evaluate a joint law once and check its outputs: NaN or a wrong shape would cause misleading errors in a
    search.
    """
    load = np.array([-500.0, 1.0, 800.0])  # N·m
    drive = JointLoading(load, np.array([-0.5, 0.1, 0.7]), np.array([60.0, 1.0, 1.0]), np.array([1, 0, 0]))
    name = f"{e.name}: law {getattr(law, 'name', type(law).__name__)!r}"
    try:
        grid = law.grid(
            JointLoadRange(max_torque=800.0, compliance=1e-6, min_angle=-1.0, max_angle=1.0, longest_history=60.0)
        )
        count = len(law.coefficients)
        answers = [
            (what, np.asarray(getattr(law, what)(np.array(shape, float), drive), float))
            for shape in (grid or (tuple(p.factor for p in law.shape),))
            for what in ("columns", "tangent")
        ]
        texts = (law.name, law.equation, law.word, *(p.key for p in (*law.coefficients, *law.shape)))
    except USER_CODE_ERRORS as problem:
        raise EffectDefinitionError(
            f"{name} does not run: {type(problem).__name__}: {problem}", file=source
        ) from problem
    if not count or not all(isinstance(text, str) for text in texts):
        raise EffectDefinitionError(
            f"{name}: coefficients and texts (name, equation, word, keys) would work", file=source
        )
    for what, answer in answers:
        if answer.ndim != 2 or len(answer) != len(load) or not answer.shape[1] or not np.isfinite(answer).all():
            raise EffectDefinitionError(
                f"{name}: {what} under {', '.join(f'{tau:g}' for tau in load)} N·m have the shape {answer.shape} (or "
                f"NaN); finite ({len(load)}, p) would work",
                file=source,
            )
