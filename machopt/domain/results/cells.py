"""What ``machopt init --json`` and ``machopt validate --json`` print."""

from __future__ import annotations

from typing import Literal

from machopt.domain.results.base import Count, Part, Text


class InitResult(Part):
    """A cell folder that was written."""

    cell: Text  # the folder
    joints: tuple[Text, ...]
    flange_link: Text
    guesses: tuple[Text, ...]  # what the user should put in or look at
    warnings: tuple[Text, ...]


class RemarkTold(Part):
    """One thing about a cell."""

    level: Literal["error", "warning"]  # error: there is no plan, or none that could be driven
    where: Text  # key of cell.yaml; empty where none is to blame
    text: Text  # what was found, and what would work


class ValidateResult(Part):
    """Everything wrong or odd about a cell, errors first."""

    cell: Text  # as the user named it
    errors: Count
    warnings: Count
    findings: tuple[RemarkTold, ...]
