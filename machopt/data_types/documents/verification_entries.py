"""Checks and measured values of a verification, as result.json and verify.json hold them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Self

from machopt.data_types.documents.document_base import DocumentModel, Flag, Known, Text


class CheckEntry(DocumentModel):
    """One promise, as the verification found it; ``passed`` null where it could not be run."""

    name: Text
    passed: Flag | None
    value: Known
    limit: Known
    unit: Text
    where: Text
    file: Text = ""  # of the folder, where the promise is about one other than trajectory.csv

    @classmethod
    def from_fields(cls, found: object) -> Self:
        """Build the entry from a check, without the keys that only code uses.

        Args:
            found: The check.
        """
        return cls(**{key: getattr(found, key) for key in cls.model_fields})


class InformationEntry(DocumentModel):
    """A measured value that no condition is put on: no check."""

    name: Text
    value: Known
    unit: Text
    where: Text
    file: Text = ""

    @classmethod
    def from_fields(cls, found: object) -> Self:
        """Build the entry from a measured value, without the key that only code uses.

        Args:
            found: The measured value.
        """
        return cls(**{key: getattr(found, key) for key in cls.model_fields})


class VerificationSection(DocumentModel):
    """All checks, and beside them what was measured without a condition."""

    passed: Flag
    checks: tuple[CheckEntry, ...]
    information: tuple[InformationEntry, ...] = ()

    @classmethod
    def from_results(cls, ok: bool, checks: Iterable[object], information: Iterable[object]) -> Self:
        """Build the section from the results of a verification.

        Args:
            ok: Whether no check failed.
            checks: The checks.
            information: The measured values without a condition.
        """
        return cls(
            passed=ok,
            checks=tuple(CheckEntry.from_fields(c) for c in checks),
            information=tuple(InformationEntry.from_fields(i) for i in information),
        )
