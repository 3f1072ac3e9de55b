"""Restriction of the xacro package: no access to Python, other files or unlimited memory.

The package evaluates expressions with ``eval``, opens every file that a robot names, and grows without bound where
macros or properties double. While :func:`limit_xacro` is entered, these functions of the package are replaced:

================== =====================================================================================
``eval_text``      expressions go to :mod:`machopt.cell.urdf.xacro_expression`; text is counted
``eval_extension`` ``$(eval …)`` likewise; ``$(env …)`` is refused
``load_yaml``      a bounded reader without tags but units of angle and length, and without repeated anchors
``parse``          files of a bounded size that may be read, without document types and entities
``resolve_macro``  what macros add is counted
``eval``, ``exec`` refused by name in every module of the package, whatever version calls them
================== =====================================================================================
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
import xml.dom.minidom
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from machopt.cell.urdf.xacro_expression import (
    EvaluationBudget,
    ExpressionFunction,
    XacroExpressionError,
    count_parts,
    evaluate_expression,
)
from machopt.cell.urdf.xacro_functions import build_symbols
from machopt.cell.urdf.xacro_yaml import read_plain_yaml
from machopt.cell.urdf.xml_tree import parse_markup
from machopt.errors import InputError, RobotModelError
from machopt.file_formats.file_reading import MARKUP, YAML, read_text

FileAccessCheck = Callable[[Path], None]
"""Raises InputError where a file may not be read."""

_MAX_OUTPUT = 2 * MARKUP  # characters of all evaluated text
_MAX_ELEMENTS = 50_000  # elements that are evaluated or copied from macros; a large public robot has 5,000
_ENVIRONMENT = re.compile(r"\$\(\s*(?:opt)?env\b")
_MATCHED = 200  # files that a pattern of an include may match
_lock = threading.RLock()  # the package keeps its state in its modules


@contextlib.contextmanager
def limit_xacro(xacro: ModuleType, find: Callable[[str], Path], may: FileAccessCheck) -> Iterator[None]:
    """Replace the functions of the xacro package for one expansion.

    Args:
        xacro: the package.
        find: folder of a package, by name.
        may: raises where a file may not be read.
    """
    import xacro.substitution_args as substitution

    with _lock:
        limits = _LimitedFunctions(xacro, find, may)
        own: dict[str, object] = {
            "eval_text": limits.eval_text,
            "safe_eval": limits.evaluate,
            "eval_extension": limits.eval_extension,
            "eval_all": limits.eval_all,
            "load_yaml": limits.load_yaml,
            "parse": limits.parse,
            "resolve_macro": limits.resolve_macro,
            "glob": limits,
            "_global_symbols": limits.symbols(),
        }
        missing = [name for name in own if name not in vars(xacro)]
        if missing:
            raise RobotModelError(
                f"the installed xacro package has no {', '.join(missing)}, so its expressions cannot be checked; "
                "xacro 2.1.1 would work"
            )
        with contextlib.ExitStack() as stack:
            for module, names in ((xacro, own), (substitution, {})):
                refusals: dict[str, object] = dict.fromkeys(("eval", "exec", "compile", "open"), _refuse_python)
                stack.enter_context(_replace_attributes(module, {**refusals, **names}))
            yield


@contextlib.contextmanager
def _replace_attributes(module: ModuleType, names: Mapping[str, object]) -> Iterator[None]:
    before = {name: vars(module)[name] for name in names if name in vars(module)}
    vars(module).update(names)
    try:
        yield
    finally:
        for name in names:
            if name in before:
                vars(module)[name] = before[name]
            else:
                del vars(module)[name]


def _refuse_python(*_: object, **__: object) -> object:
    raise XacroExpressionError("would be evaluated by Python or opened unchecked, which is refused")


class _LimitedFunctions:
    """The replacements, with what one expansion has used."""

    def __init__(self, xacro: Any, find: Callable[[str], Path], may: FileAccessCheck) -> None:
        self.xacro, self.find, self.may = xacro, find, may
        self.budget = EvaluationBudget()
        self.characters = self.elements = 0
        self.sizes: dict[int, int] = {}  # elements in the body of a macro, by its identity
        self._eval_all, self._resolve_macro = xacro.eval_all, xacro.resolve_macro

    def symbols(self) -> dict[str, object]:
        def argument(name: str) -> object:
            return self.arguments()[name]

        def absolute(name: str) -> str:
            return str(self.xacro.abs_filename_spec(name))

        return build_symbols(
            load_yaml=self.load_yaml, absolute_name=absolute, argument=argument, print_text=self.xacro.message
        )

    def arguments(self) -> dict[str, Any]:
        found: dict[str, Any] = self.xacro.substitution_args_context["arg"]
        return found

    # text ---------------------------------------------------------------------------------------------------------

    def evaluate(self, text: str, symbols: Any, _: object = None) -> object:
        return evaluate_expression(text, symbols, self.budget)

    def eval_text(self, text: str, symbols: Any) -> object:
        """Text with its expressions and substitutions carried out; a lone expression keeps its type."""
        lexer = self.xacro.QuickLexer(self.xacro.LEXER)
        lexer.lex(text)
        results: list[object] = []
        while lexer.peek():
            kind, found = lexer.next()
            if kind == lexer.EXPR:
                results.append(self._evaluate_expression(found[2:-1], symbols))
            elif kind == lexer.EXTENSION:
                results.append(self.eval_extension(f"$({self.eval_text(found[2:-1], symbols)})"))
            else:
                results.append(found[1:] if kind == lexer.DOLLAR_DOLLAR_BRACE else found)
            value = results[-1]
            self._count(len(value) if isinstance(value, str) else count_parts(value))
        return results[0] if len(results) == 1 else "".join(map(str, results))

    def _evaluate_expression(self, text: str, symbols: Any) -> object:
        inner = str(self.eval_text(text, symbols))
        try:
            return self.evaluate(inner, symbols)
        except XacroExpressionError as problem:
            raise self.xacro.XacroException(f"the expression {inner!r} {problem}") from None

    def _count(self, characters: int) -> None:
        self.characters += characters
        if self.characters > _MAX_OUTPUT:
            raise XacroExpressionError(f"expands to more than {_MAX_OUTPUT} characters")

    def eval_extension(self, text: str) -> object:
        """``$(find …)``, ``$(arg …)``, ``$(dirname)``, ``$(eval …)``."""
        if _ENVIRONMENT.match(text):
            raise _build_environment_error()
        if text.startswith("$(eval ") and text.endswith(")"):
            values = {name: _convert_argument(value) for name, value in self.arguments().items()}
            functions = {
                "arg": ExpressionFunction("arg", lambda name: _convert_argument(self.arguments()[name])),
                "find": ExpressionFunction("find", lambda name: str(self.find(name))),
                "true": True,
                "false": False,
            }
            return str(self.evaluate(text[len("$(eval ") : -1], {**self.symbols(), **functions, **values}))
        if text == "$(cwd)":
            raise RobotModelError("uses the current folder with $(cwd), so the robot depends on the folder")
        from xacro.substitution_args import ArgException, resolve_args

        try:
            return resolve_args(text, context=self.xacro.substitution_args_context)
        except ArgException as problem:
            raise self.xacro.XacroException("Undefined substitution argument", exc=problem) from None

    # elements -----------------------------------------------------------------------------------------------------

    def eval_all(self, node: Any, macros: Any, symbols: Any) -> None:
        self._add(1)
        for child in node.childNodes:  # the package takes no argument without a default, even where its value is given
            if getattr(child, "tagName", "") == "xacro:arg" and not child.hasAttribute("default"):
                if child.getAttribute("name") not in self.arguments():
                    raise build_missing_argument_error(child.getAttribute("name"))
                child.setAttribute("default", "")
        self._eval_all(node, macros, symbols)

    def resolve_macro(self, name: str, macros: Any, symbols: Any) -> Any:
        found = self._resolve_macro(name, macros, symbols)
        body = found[2].body
        if id(body) not in self.sizes:
            self.sizes[id(body)] = len(body.getElementsByTagName("*"))
        self._add(self.sizes[id(body)])
        return found

    def _add(self, elements: int) -> None:
        self.elements += elements
        if self.elements > _MAX_ELEMENTS:
            raise XacroExpressionError(f"expands to more than {_MAX_ELEMENTS} elements")

    # files --------------------------------------------------------------------------------------------------------

    def parse(self, inp: object, filename: str | None = None) -> xml.dom.minidom.Document:
        """A file as a tree, without document types and entities."""
        assert inp is None
        assert filename is not None  # the package is only started with files
        path = Path(filename)
        self.may(path)
        if not path.exists():
            self.xacro.filestack.pop()
            missing = FileNotFoundError(2, "no such file", str(path))  # what an optional include passes over
            raise self.xacro.XacroException(f"no such file: {path}", exc=missing)
        text = read_text(path, expected="a xacro file", most=MARKUP)
        parse_markup(text, path, "a xacro file")
        return xml.dom.minidom.parseString(text.encode("utf-8"))

    def glob(self, pattern: str) -> list[str]:
        """Files that the pattern of an include matches; only its last part may hold wild cards."""
        folder, name = os.path.split(pattern)
        if re.search(r"[*\[?]", folder):
            raise RobotModelError(f"includes {pattern}; wild cards are carried out in the file's name only")
        self.may(Path(folder) / "any")
        found = sorted(Path(folder).glob(name)) if os.path.isdir(folder) else []
        if len(found) > _MATCHED:
            raise RobotModelError(f"includes {len(found)} files by {pattern}; at most {_MATCHED} are read")
        return [str(f) for f in found]

    def load_yaml(self, name: str) -> object:
        """Content of a YAML file, counted as an included file."""
        if not isinstance(name, str):
            raise XacroExpressionError("load_yaml takes the name of a file")
        path = Path(str(self.xacro.abs_filename_spec(name)))
        self.may(path)
        text = read_text(path, expected="a YAML file", most=YAML)
        self.xacro.all_includes.append(str(path))
        return read_plain_yaml(text, path)


def _build_environment_error() -> InputError:
    return RobotModelError(
        "uses an environment variable, so the robot depends on the machine; $(arg NAME) with "
        "--xacro-arg NAME=VALUE (in cell.yaml `xacro_args: {NAME: …}` under robot:) would work"
    )


def build_missing_argument_error(name: str, path: Path | None = None) -> InputError:
    """Build the error of a file whose argument has no value.

    Args:
        name: Name of the argument.
        path: Path of the file, None where not known.

    Returns:
        The error, not raised.
    """
    return RobotModelError(
        f"needs the argument {name}; --xacro-arg {name}=VALUE (in cell.yaml `xacro_args: {{{name}: …}}` under robot:) "
        "would work",
        file=path,
    )


def _convert_argument(text: object) -> object:
    """A substitution argument as a number or truth value where it is one."""
    if not isinstance(text, str):
        return text
    for convert in (int, float):
        with contextlib.suppress(ValueError):
            return convert(text)
    return {"true": True, "false": False}.get(text.lower(), text)
