"""Lines of the terminal about the checks and measured values of a verification."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from machopt.cli.result_values import convert_null_to_nan

if TYPE_CHECKING:
    from machopt.data_types.documents.optimize_document import OptimizeDocument
    from machopt.data_types.documents.verification_entries import CheckEntry
    from machopt.verification import VerificationCheck, VerificationInformation


def format_check_line(c: VerificationCheck) -> str:
    """Return a check as one line.

    Args:
        c: The check.
    """
    if c.passed is None:
        return f"–    {c.name}: not run, {c.where}"
    where = "" if c.passed or not c.where else f" at {c.where}"
    if c.passed is False and c.limit == 0.0:
        return f"FAIL {c.name}: {c.where}"
    if c.beyond and c.value <= 0.0:
        return f"ok   {c.name}: {-c.value:.4g} {c.beyond} within the limit{where}"
    if math.isnan(c.value) and math.isnan(c.limit):
        return f"{'ok  ' if c.passed else 'FAIL'} {c.name}{where.replace(' at ', ': ', 1)}"
    return f"{'ok  ' if c.passed else 'FAIL'} {c.name}: {c.value:.4g} {c.unit} (limit {c.limit:.4g}){where}"


def format_information_line(i: VerificationInformation) -> str:
    """Return a measured value as one line; it has neither a limit nor a result.

    Args:
        i: The measured value.
    """
    value = "" if math.isnan(i.value) else f": {i.value:.4g} {i.unit}"
    return f"info {i.name}{value}{f', {i.where}' if i.where else ''}"


def format_failed_verification(result: OptimizeDocument) -> str:
    """Return the failed checks of a result.

    Args:
        result: The content of result.json.
    """
    from machopt.cli.check_failures import format_failures

    checks = result.verification.checks if result.verification else []
    return format_failures([_convert_to_check(c) for c in checks])


def _convert_to_check(c: CheckEntry) -> VerificationCheck:
    from machopt.verification import VerificationCheck

    return VerificationCheck(
        name=c.name,
        passed=c.passed,
        value=convert_null_to_nan(c.value),
        limit=convert_null_to_nan(c.limit),
        unit=c.unit,
        where=c.where,
        file=c.file,
    )
