"""Expansion of xacro to URDF by the ``xacro`` package of the ROS maintainers.

Every file that is read is recorded as an input of the cell. ``$(find NAME)`` resolves packages of the cell only: a
package index of this computer would give another robot elsewhere. For the same reason ``$(env …)`` is refused.
Expressions in ``${…}`` may use only a few Python functions.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from xml.parsers.expat import ExpatError

from machopt.cell.urdf.xacro_limits import FileAccessCheck, build_missing_argument_error, limit_xacro
from machopt.errors import InputError, RobotModelError
from machopt.file_formats.file_reading import MARKUP, read_text

PackageFinder = Callable[[str], Path]
_ELEMENT = re.compile(r"<xacro:\w")
_ARGUMENT = re.compile(r"<xacro:arg\s[^>]*?name\s*=\s*[\"']([^\"']+)[\"']|\$\(arg\s+(\w+)\s*\)")
_ENVIRONMENT = re.compile(r"\$\((?:opt)?env\b")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


@dataclass(frozen=True)
class ExpandedXacro:
    """A URDF that was written as xacro."""

    text: str
    files: tuple[Path, ...]  # all that were read, resolved, the first one first
    warnings: tuple[str, ...]  # what xacro printed


def is_xacro(path: Path) -> bool:
    """Return whether a file is xacro, by its name or because it uses the language.

    Args:
        path: Path of the file.
    """
    return path.suffix.lower() == ".xacro" or bool(_ELEMENT.search(_read_without_comments(path, "a URDF")))


def _read_without_comments(path: Path, expected: str) -> str:
    """The text of a file without its comments."""
    return _COMMENT.sub("", read_text(path, expected=expected, most=MARKUP))


_FAILURES_OF_EXPRESSIONS = (
    ValueError,
    TypeError,
    AttributeError,
    LookupError,
    NameError,
    ArithmeticError,
    SyntaxError,
    RuntimeError,  # attributes that are missing, and recursion without end
    OSError,
)


def expand_xacro(path: Path, arguments: Mapping[str, str], find: PackageFinder, may: FileAccessCheck) -> ExpandedXacro:
    """Carry out a xacro file.

    Args:
        path: the file.
        arguments: values of its ``<xacro:arg>``.
        find: folder of a package, by name; raises InputError where there is none.
        may: called with every file before it is opened; raises InputError where it may not be read.

    Raises:
        InputError: the package xacro is missing, the file cannot be carried out, an argument is missing or unknown, or
            the result depends on the environment.
    """
    try:
        import xacro
        from xacro import XacroException
        from xacro.substitution_args import ArgException, SubstitutionException
    except ImportError:
        raise RobotModelError(
            "is a xacro file, and the Python package xacro is not installed; `pip install xacro`, or the URDF "
            "it expands to, would work",
            file=path,
        ) from None
    failures = (XacroException, SubstitutionException, *_FAILURES_OF_EXPRESSIONS)
    output, known = io.StringIO(), len(xacro.all_includes)
    try:
        with (
            _replace_package_index(find),
            limit_xacro(xacro, find, may),
            contextlib.redirect_stderr(output),
            contextlib.redirect_stdout(output),
        ):
            document = xacro.process_file(str(path), mappings=dict(arguments))
            text = document.toprettyxml(indent="  ")
    except InputError as problem:
        raise RobotModelError(
            problem.reason, file=problem.file or _get_current_file(xacro.filestack, path), where=problem.where
        ) from None
    except ExpatError as problem:
        where = xacro.filestack[-1] if xacro.filestack else path
        raise RobotModelError(f"is not XML: {problem}", file=where) from None
    except failures as problem:
        missing = getattr(problem, "exc", None)
        if isinstance(missing, InputError):  # a package that was not found, wrapped by xacro
            raise missing from None
        if isinstance(missing, ArgException):
            raise build_missing_argument_error(str(missing), path) from None
        stack = [f for f in (xacro.filestack or []) if f]
        where = f"in {stack[-1]}" if len(stack) > 1 else None
        raise RobotModelError(f"cannot be expanded: {_shorten_message(problem)}", file=path, where=where) from None
    files = tuple(dict.fromkeys(Path(f).resolve() for f in (path, *xacro.all_includes[known:])))
    _check_arguments(path, files, arguments)
    return ExpandedXacro(text, files, tuple(dict.fromkeys(_split_lines(output.getvalue()))))


def _get_current_file(stack: list[str | None] | None, path: Path) -> Path:
    """The file that was being read."""
    return Path(next((f for f in reversed(stack or []) if f), path))


def _check_arguments(path: Path, files: tuple[Path, ...], arguments: Mapping[str, str]) -> None:
    declared: set[str] = set()
    for file in files:
        if file.suffix.lower() in (".yaml", ".yml"):
            continue
        text = _read_without_comments(file, "a xacro file")
        declared |= {name for found in _ARGUMENT.findall(text) for name in found if name}
        if _ENVIRONMENT.search(text):
            raise RobotModelError(
                "uses an environment variable, so the robot depends on the machine; $(arg NAME) with "
                "--xacro-arg NAME=VALUE (in cell.yaml `xacro_args: {NAME: …}` under robot:) would work",
                file=file,
            )
    unknown = [name for name in arguments if name not in declared]
    if unknown:
        raise RobotModelError(
            f"has no <xacro:arg name={unknown[0]!r}>; valid: {', '.join(sorted(declared)) or 'none'}", file=path
        )


@contextlib.contextmanager
def _replace_package_index(find: PackageFinder) -> Iterator[None]:
    """Replace the package index of xacro, and restore it afterwards."""

    def folder(name: str) -> str:
        return str(find(name))

    index, packages = ModuleType("ament_index_python"), ModuleType("ament_index_python.packages")
    packages.__dict__["get_package_share_directory"] = folder
    index.__dict__["packages"] = packages
    names = {"ament_index_python": index, "ament_index_python.packages": packages}
    before = {name: sys.modules.get(name) for name in names}
    sys.modules.update(names)
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def _split_lines(text: str) -> list[str]:
    return [plain for line in text.splitlines() if (plain := re.sub(r"\x1b\[[0-9;]*m", "", line).strip())]


def _shorten_message(problem: BaseException) -> str:
    """The beginning of a message, its own file left out."""
    return " ".join((str(problem) or type(problem).__name__).split())[:300]
