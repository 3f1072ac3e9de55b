"""Functions and constants that expressions of xacro files may use.

The names are those of the xacro package: mathematics directly and under ``math.``, Python's own under ``python.`` and
partly directly, xacro's under ``xacro.``. A name that is not listed is not defined, whatever the package offers.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from machopt.cell.urdf.xacro_expression import (
    MAX_ITEMS,
    ExpressionFunction,
    FunctionTable,
    XacroExpressionError,
    check_bounds,
)

_MATH = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    *("degrees", "radians", "hypot", "sqrt", "exp", "expm1", "log", "log10", "log1p", "log2", "pow"),
    *("ceil", "floor", "trunc", "fabs", "fmod", "remainder", "modf", "frexp", "fsum", "gcd", "copysign"),
    *("isclose", "isfinite", "isinf", "isnan"),
)
"""Without comb, factorial, lcm, perm and prod, whose integers grow without bound."""
_CONSTANTS = ("pi", "e", "tau", "inf", "nan")
_PLACES = 300  # decimal places to which a float can be rounded
_DIRECT = ("list", "dict", "map", "len", "str", "float", "int", "bool", "min", "max", "round")


def build_symbols(
    *,
    load_yaml: Callable[[str], object],
    absolute_name: Callable[[str], str],
    argument: Callable[[str], object],
    print_text: Callable[[str], None],
) -> dict[str, object]:
    """Return the global symbols of an expansion.

    Args:
        load_yaml: content of a YAML file, by its name.
        absolute_name: file name relative to the xacro file that is being read.
        argument: value of a substitution argument, by its name.
        print_text: receives what ``xacro.message`` and its like print.
    """
    mathematics = FunctionTable({name: ExpressionFunction(name, getattr(math, name)) for name in _MATH})
    mathematics |= {name: getattr(math, name) for name in _CONSTANTS}
    own = {name: ExpressionFunction(name, call) for name, call in _list_python_functions().items()}

    def message(*args: object, **_: object) -> str:
        print_text(" ".join(map(str, args)))
        return ""

    def fatal(*args: object) -> str:
        raise XacroExpressionError(" ".join(map(str, args)) or "xacro.fatal was called")

    calls: dict[str, Callable[..., object]] = {
        "load_yaml": load_yaml,
        "abs_filename": absolute_name,
        "arg": argument,
        "dotify": lambda value: value,  # entries of every dictionary are members already
        "tokenize": _tokenize_text,
        "fatal": fatal,
    } | dict.fromkeys(("message", "warning", "error", "print_location"), message)
    xacro = FunctionTable({name: ExpressionFunction(name, call) for name, call in calls.items()})
    return {
        **mathematics,
        **{name: own[name] for name in (*_DIRECT, "sorted", "range")},
        **{name: xacro[name] for name in ("load_yaml", "abs_filename", "dotify")},
        "True": True,
        "False": False,
        "math": mathematics,
        "python": FunctionTable(own),
        "xacro": xacro,
    }


def _list_python_functions() -> dict[str, Callable[..., object]]:
    """Functions of Python's own, on the values of expressions; what makes an iterator there makes a list here."""
    return {
        "list": lambda value=(): _list_elements(value),
        "tuple": lambda value=(): tuple(_list_elements(value)),
        "dict": _build_dictionary,
        "map": _map_values,
        "len": lambda value: len(_list_elements(value)),
        "str": _format_text,
        "repr": lambda value: repr(_check_data(value)),
        "float": lambda value=0.0: float(_check_scalar(value)),
        "int": lambda value=0, base=None: (
            int(_check_scalar(value)) if base is None else int(str(_check_scalar(value)), int(base))
        ),
        "bool": lambda value=False: bool(value),
        "min": min,
        "max": max,
        "round": _round_value,
        "abs": abs,
        "all": lambda values: all(_list_elements(values)),
        "any": lambda values: any(_list_elements(values)),
        "divmod": lambda a, b: (_list_numbers([a, b])[0] // b, a % b),
        "enumerate": lambda values, start=0: [[n, v] for n, v in enumerate(_list_elements(values), start)],
        "ord": ord,
        "reversed": lambda values: _list_elements(values)[::-1],
        "sum": lambda values, start=0: sum(_list_numbers(values), start),
        "zip": lambda *rows: [list(row) for row in zip(*map(_list_elements, rows), strict=False)],
        "sorted": lambda values, reverse=False: sorted(_list_elements(values), reverse=bool(reverse)),  # type: ignore[type-var]
        "range": _build_range,
    }


def _list_elements(value: object) -> list[object]:
    if not isinstance(value, (str, list, tuple, dict)):
        raise XacroExpressionError(f"takes the elements of {type(value).__name__}, which has none")
    return list(value)


def _list_numbers(value: object) -> list[float]:
    found = _list_elements(value)
    if not all(isinstance(v, (int, float)) for v in found):
        raise XacroExpressionError("adds up elements that are no numbers")
    return found  # type: ignore[return-value]


def _check_scalar(value: object) -> str | float:
    if not isinstance(value, (str, int, float)) or (isinstance(value, str) and len(value) > 400):
        raise XacroExpressionError(f"makes a number of {type(value).__name__}; a number or a text of one is expected")
    return value


def _check_data(value: object) -> object:
    """A value that holds no functions, which have no text."""
    if isinstance(value, ExpressionFunction) or (isinstance(value, dict) and type(value) is not dict):
        raise XacroExpressionError("makes text of a function or of a name space")
    return check_bounds(value)


def _format_text(value: object = "") -> str:
    return str(_check_data(value))


def _build_dictionary(value: object = (), /, **named: object) -> dict[object, object]:
    rows = [*value.items()] if isinstance(value, dict) else [_list_elements(pair) for pair in _list_elements(value)]
    out: dict[object, object] = {}
    for key, found in [*rows, *named.items()]:
        out[key] = found
    return out


def _check_function(value: object) -> Callable[..., object]:
    if not isinstance(value, ExpressionFunction):
        raise XacroExpressionError("map takes a function of this language first")
    return value.call


def _map_values(call: object, *rows: object) -> list[object]:
    function = _check_function(call)
    return [function(*row) for row in zip(*map(_list_elements, rows), strict=False)]


def _round_value(value: float, places: int | None = None) -> float:
    if places is not None and not -_PLACES <= places <= _PLACES:
        raise XacroExpressionError(f"rounds to {places} places; expected -{_PLACES} to {_PLACES}")
    return round(value) if places is None else round(value, places)


def _build_range(*ends: int) -> list[int]:
    found = range(*ends)
    if len(found) > MAX_ITEMS:
        raise XacroExpressionError(f"makes a range of {len(found)} numbers; at most {MAX_ITEMS} are evaluated")
    return list(found)


def _tokenize_text(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    """The pieces of a text between any of the characters ``sep``."""
    for mark in sep[1:]:
        text = text.replace(mark, sep[0])
    return [piece for piece in text.split(sep[0]) if piece or not skip_empty]
