"""Languages and posts of all makers, from the folders of this package that hold a module
``language_registration``."""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module, resources
from importlib.resources.abc import Traversable
from types import MappingProxyType

import machopt.programs
from machopt.programs.checking.program_checks import ProgramChecks
from machopt.programs.maker_contract import ProgramLanguage


@cache
def list_languages() -> tuple[ProgramLanguage, ...]:
    """Return every language; where patterns of two match, the first one counts."""
    found: list[ProgramLanguage] = []
    for package in _list_maker_packages():
        found += import_module(f"{package}.language_registration").LANGUAGES
    return tuple(sorted(found, key=lambda language: language.priority))


@cache
def find_language(dialect: str) -> ProgramLanguage:
    """Return the language of a program that was read.

    Args:
        dialect: ``ParsedProgram.dialect``.
    """
    return next(language for language in list_languages() if language.dialect == dialect)


@cache
def list_template_languages() -> Mapping[str, ProgramLanguage]:
    """Return the languages by the dialect of their posts; two that share one have the same rules."""
    return MappingProxyType({language.template_dialect: language for language in list_languages()})


@cache
def list_templates() -> Mapping[str, Traversable]:
    """Return the files of the shipped posts by name, sorted."""
    folders = [resources.files(package) / "templates" for package in _list_maker_packages()]
    files = [file for folder in folders if folder.is_dir() for file in folder.iterdir() if file.name.endswith(".toml")]
    return MappingProxyType({file.name.removesuffix(".toml"): file for file in sorted(files, key=lambda f: f.name)})


def load_checks(dialect: str) -> ProgramChecks:
    """Return the checks of a language; those of a maker without any check nothing.

    Args:
        dialect: ``ParsedProgram.dialect``.
    """
    language = find_language(dialect)
    checks: ProgramChecks = language.load(language.checks) if language.checks else ProgramChecks()
    return checks


def _list_maker_packages() -> list[str]:
    packages = [f"machopt.programs.{m.name}" for m in pkgutil.iter_modules(machopt.programs.__path__) if m.ispkg]
    return [name for name in packages if (resources.files(name) / "language_registration.py").is_file()]
