"""What the folder of a maker offers: ``machopt/programs/<maker>/language_registration.py`` holds a list ``LANGUAGES``.

A folder holds everything about its maker::

    language_registration.py  LANGUAGES: one ProgramLanguage each
    post_rules.py  fields of the maker for the templates (writing)
    reader.py         reader of programs; imports neither post_rules.py nor machopt.programs.writing
    checks.py       words of a program that the verification recomputes (optional)
    templates/      shipped posts, NAME.toml

:mod:`machopt.programs.maker_registry` finds the folders. Nothing else names a maker.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any, Literal

ExternalOrder = Literal["number", "cell", "ascending", "group"]


@dataclass(frozen=True, kw_only=True)
class ProgramLanguage:
    """One language of robot programs.

    Reader, rules and checks are named as ``module:name`` below the maker's folder and imported when they are used.
    """

    package: str  # of the folder: ``__package__`` in language_registration.py
    name: str  # in messages, e.g. KUKA KRL
    dialect: str  # of programs that were read
    pattern: str  # regular expression; a program has a match in its first lines
    reader: str  # function (source, arc_tolerance, strict) → ParsedProgram
    rules: str = "post_rules:DIALECT"  # MakerRules of the posts
    checks: str = ""  # ProgramChecks
    post_dialect: str = ""  # ``dialect`` of the posts, where it is another
    priority: int = 50  # lower first, where the patterns of two languages match
    reads_pulses: bool = False  # joints are encoder counts; the reader takes pulses_per_deg as a fourth argument
    feed_step: float = 1e-6  # m/s, to which printed feeds are rounded
    parent_levels: int = 0  # folders between the output folder and the file that is read
    uses_urdf_joints: bool = False  # angles and frames are those of the URDF, whatever the cell says of its controller
    couples_frames: bool = False  # the controller moves base frames with rail and positioner
    shows_coupling: bool = False  # of these, programs that show it
    has_zones: bool = True  # False: the format has no blend zones
    external_order: ExternalOrder = "group"
    """Columns of external axes: by the number of the axis, as in the cell, by ascending number without gaps, or so with
    the axes that carry the robot first."""
    external_in_si: bool = False  # external values in m and rad, else mm and deg

    @cached_property
    def known_by(self) -> re.Pattern[str]:
        """The compiled pattern."""
        return re.compile(self.pattern, re.MULTILINE)

    @property
    def template_dialect(self) -> str:
        """``dialect`` of the posts of this language."""
        return self.post_dialect or self.dialect

    def load(self, reference: str) -> Any:
        """Import an object of the maker's folder.

        Args:
            reference: ``module:name``, e.g. ``reader:read_krl``.
        """
        module, _, name = reference.partition(":")
        return getattr(import_module(f"{self.package}.{module}"), name)
