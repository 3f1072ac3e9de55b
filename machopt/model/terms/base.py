"""What a term is, how one is made from the parameters of a file, and which effects exist."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from machopt.domain.stiffness import Term
from machopt.errors import InputError
from machopt.model.robot import ArmState, Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Coefficient:
    """One number of a term that a fit can find, in SI; a compliance, so that zero means rigid."""

    name: str  # as in the file where the file holds it directly, e.g. "1/EI"
    unit: str  # SI
    lower: float = 0.0  # −inf where the sign is free


class LinearTerm(Protocol):
    """Elastic physics whose twist at the TCP is linear in its coefficients, and in the wrench but for two families.

    :class:`machopt.model.terms.laws.TorqueLaw` follows the joint's torque along a curve, and
    :class:`machopt.model.terms.compensator.GravityCompensator` is a spring beside one of the joints.
    """

    @property
    def effect(self) -> str: ...

    @property
    def location(self) -> str: ...

    @property
    def coefficients(self) -> tuple[Coefficient, ...]: ...

    @property
    def values(self) -> Array:
        """(P,) the coefficients' values in SI; NaN for a term that is still to be fitted."""
        ...

    def response(self, state: ArmState, wrench: Array) -> Array:
        """Twist of the TCP per unit of each coefficient.

        Args:
            state: M configurations with bodies.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.

        Returns:
            (M, 6, P) m, rad per unit; base_link axes, at the TCP.
        """
        ...

    def with_values(self, values: Array) -> LinearTerm:
        """The same term with other coefficients (P,)."""
        ...

    def to_file(self) -> Term:
        """The term as stiffness.yaml holds it."""
        ...


Maker = Callable[[Robot, Array, "Parameters", str], LinearTerm]


class Parameters:
    """The parameters of one term, read key by key; what is not asked for is an error."""

    def __init__(self, data: Mapping[str, Any], where: str, file: Any = None) -> None:
        self._data, self._where, self._file = dict(data), where, file
        self._asked: list[str] = []

    def error(self, key: str, message: str) -> InputError:
        return InputError(message, file=self._file, where=f"{self._where}{f'.{key}' if key else ''}")

    def inner(self, key: str, data: Mapping[str, Any]) -> Parameters:
        """The reader of a mapping inside this one."""
        return Parameters(data, f"{self._where}.{key}", self._file)

    def word(self, key: str) -> str:
        """A word, empty where the key is missing."""
        return str(self._data[key]) if self.has(key) else ""

    def has(self, key: str) -> bool:
        self._asked.append(key)
        return key in self._data

    def number(self, key: str, default: float | None = None, *, positive: bool = True) -> float:
        """A finite number, above zero unless ``positive`` is off."""
        if not self.has(key):
            if default is None:
                raise self.error(key, f"is missing; {key} is needed here")
            return default
        value = self._data[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise self.error(key, f"found {value!r}; expected a number")
        if positive and not value > 0:
            raise self.error(key, f"found {value:g}; expected more than zero")
        return float(value)

    @property
    def empty(self) -> bool:
        """Nothing is stated: a term to be found."""
        return not self._data

    def choice(self, key: str, valid: Sequence[str], default: str) -> str:
        """One of a few words."""
        if not self.has(key):
            return default
        value = self._data[key]
        if value not in valid:
            raise self.error(key, f"found {value!r}; valid: {', '.join(valid)}")
        return str(value)

    def row(self, key: str, *, least: float = -np.inf) -> Array:
        """One or more finite numbers in a list, none below ``least``; empty where the key is missing."""
        if not self.has(key):
            return np.empty(0)
        value = self._data[key]
        if not isinstance(value, list) or not value:
            raise self.error(key, f"found {value!r}; expected a list of numbers")
        for n, entry in enumerate(value):
            if isinstance(entry, bool) or not isinstance(entry, int | float) or not np.isfinite(entry):
                raise self.error(f"{key}[{n}]", f"found {entry!r}; expected a number")
            if entry < least:
                raise self.error(f"{key}[{n}]", f"found {entry:g}; expected at least {least:g}")
        return np.array(value, dtype=float)

    def array(self, key: str, shape: tuple[int, ...], default: Array | None = None) -> Array:
        """Finite numbers of a given shape."""
        if not self.has(key):
            if default is None:
                raise self.error(key, f"is missing; expected {_shape(shape)} numbers")
            return default
        try:
            value = np.array(self._data[key], dtype=float)
        except (TypeError, ValueError):
            value = np.array(np.nan)
        if value.shape != shape or not np.isfinite(value).all():
            raise self.error(key, f"found {self._data[key]!r}; expected {_shape(shape)} finite numbers")
        return value

    def mappings(self, key: str) -> list[dict[str, Any]]:
        """A list of mappings."""
        value = self._data.get(key)
        self._asked.append(key)
        if not isinstance(value, list) or not value or not all(isinstance(v, dict) for v in value):
            raise self.error(key, f"found {value!r}; expected a list of mappings")
        return value

    def finish(self) -> None:
        """Refuse keys that nothing asked for."""
        for key in self._data:
            if key not in self._asked:
                valid = sorted(set(self._asked))
                close = difflib.get_close_matches(key, valid, n=1)
                hint = f"did you mean {close[0]!r}? " if close else ""
                raise self.error(key, f"unknown key; {hint}valid: {', '.join(valid)}")


def vocabulary() -> dict[str, tuple[str, ...]]:
    """Effects that can stand in ``terms`` and their locations."""
    joints = tuple(f"joint:{i}" for i in range(1, 7))
    return {
        "link_compliance": tuple(f"link:{i}" for i in range(1, 7)),
        "base_compliance": ("base",),
        "tool_compliance": ("tool",),
        "joint_coupling": tuple(f"joint:{i}-{j}" for i in range(1, 7) for j in range(i + 1, 7)),
        "joint_pose_dependent_stiffness": joints,
        "joint_nonlinear_stiffness": joints,
        "joint_backlash": joints,
        "joint_hysteresis": joints,
        "joint_creep": joints,
        "gravity_compensator": ("joint:2",),
        "geometric_stiffness": ("arm",),
    }


def compile_terms(
    terms: Sequence[Term], robot: Robot, T_flange_tcp: Array, file: Any = None
) -> tuple[tuple[LinearTerm, ...], bool]:
    """Make a stiffness file's terms ready for computing.

    Args:
        terms: as the file lists them.
        robot: the arm they belong to.
        T_flange_tcp: (4, 4).
        file: named in messages.

    Returns:
        the linear terms, and whether the geometric stiffness K_C is to be counted.

    Raises:
        InputError: an effect, location or parameter that does not exist or does not fit.
    """
    out: list[LinearTerm] = []
    geometric = False
    seen: set[tuple[str, str]] = set()
    for n, term in enumerate(terms):
        where = f"terms[{n}]"
        _check_place(term, where, file)
        if (term.effect, term.location) in seen:
            raise InputError(f"{term.effect} at {term.location} stands twice; keep one", file=file, where=where)
        seen.add((term.effect, term.location))
        parameters = Parameters(term.parameters, f"{where}.parameters", file)
        if term.effect == "geometric_stiffness":
            geometric = True
        else:
            out.append(_maker(term.effect)(robot, T_flange_tcp, parameters, term.location))
        parameters.finish()
    return tuple(out), geometric


def term_of(effect: str, location: str, robot: Robot, T_flange_tcp: Array, **parameters: Any) -> LinearTerm:
    """One term by name; without the parameters that hold its coefficients it is one to be fitted."""
    terms, _ = compile_terms((Term(effect, location, parameters),), robot, T_flange_tcp)
    return terms[0]


def _check_place(term: Term, where: str, file: Any) -> None:
    known = vocabulary()
    if term.effect not in known:
        close = difflib.get_close_matches(term.effect, known, n=1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        raise InputError(
            f"effect {term.effect!r} is not known; {hint}valid: {', '.join(known)}", file=file, where=f"{where}.effect"
        )
    if term.location not in known[term.effect]:
        raise InputError(
            f"{term.effect} cannot be at {term.location!r}; valid: {_some(known[term.effect])}",
            file=file, where=f"{where}.location",
        )  # fmt: skip


def _maker(effect: str) -> Maker:
    from machopt.model.terms import body, compensator, joint, laws

    return {**joint.MAKERS, **laws.MAKERS, **compensator.MAKERS, **body.MAKERS}[effect]


def _some(words: Sequence[str]) -> str:
    return ", ".join(words) if len(words) <= 6 else f"{', '.join(words[:3])} … {words[-1]}"


def _shape(shape: tuple[int, ...]) -> str:
    return " × ".join(map(str, shape))


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters as YAML takes them."""
    return {k: v.tolist() if isinstance(v, np.ndarray | np.generic) else v for k, v in values.items()}
