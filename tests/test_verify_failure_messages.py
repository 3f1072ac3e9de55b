"""First message of ``machopt verify``: the cause of a failure, not its consequences."""

from __future__ import annotations

import math

import numpy as np
import pytest

from machopt.cli.check_failures import format_failures, sort_causes_first
from machopt.data_types.manifest import CheckCoverage
from machopt.verification import VerificationCheck
from machopt.verification.check_results import CheckName, build_file_check
from machopt.verification.folder.result_json.comparison_inputs import format_json_value

OK = VerificationCheck(name="path", passed=True, value=0.006, limit=0.02, unit="mm", where="sample 3")
FILES = VerificationCheck(
    name=CheckName.FILES,
    passed=False,
    value=1.0,
    limit=0.0,
    unit="differences",
    where="points.csv is changed: 9 bytes, 8 were written",
    file="points.csv",
)
INPUTS = VerificationCheck(
    name=CheckName.INPUTS,
    passed=False,
    value=1.0,
    limit=0.0,
    unit="differences",
    where="another stiffness: stiffness.yaml is other",
)
COLUMN = VerificationCheck(
    name="points.csv k_axial_N_mm",
    passed=False,
    value=9618.0,
    limit=1.0,
    unit="of 1 N/mm",
    where="point 7: 4 N/mm, 5 N/mm follows",
    file="points.csv",
    what="k_axial_N_mm",
    instead=True,
)
NOT_THERE = "cannot be read: No such file or directory"
LOST = build_file_check("trajectory.csv", CheckName.READABLE, False, math.nan, math.nan, "", NOT_THERE, of=" ")
UNREAD = "/out/trajectory.csv: cannot be read"
PROGRAMS = VerificationCheck(
    name=CheckName.PROGRAMS,
    passed=False,
    value=math.nan,
    limit=math.nan,
    unit="",
    where=UNREAD,
    because="trajectory.csv",
)
SAID = "exit_code is 0, 4 follows"
VERDICT = build_file_check("result.json", CheckName.VERDICT, False, 1.0, 0.0, "differences", SAID, of=" ")
TIMES = build_file_check("result.json", "times", False, 1.0, 0.0, "differences", UNREAD, of=" ")
JERK = VerificationCheck(
    name=CheckName.JERK, passed=False, value=2.577, limit=1.1, unit="of the limit", where="axis 2, sample 775"
)
INDEX = VerificationCheck(
    name="index of the samples", passed=False, value=4.0, limit=0.02, unit="mm", where="sample 766, point 8.000"
)


@pytest.mark.parametrize(
    ("checks", "first", "last"),
    [
        (
            (OK, FILES, COLUMN, VERDICT),
            "points.csv is changed: 9 bytes, 8 were written; points.csv k_axial_N_mm: point 7: 4 N/mm, 5 N/mm follows",
            "  because of that also: result.json verdict",
        ),
        (
            (COLUMN, VERDICT),
            "points.csv k_axial_N_mm: point 7: 4 N/mm, 5 N/mm follows",
            "  because of that also: result.json verdict",
        ),
        (
            (FILES, INPUTS, COLUMN),
            "OUT was not made from these inputs: another stiffness: stiffness.yaml is other",
            "  also points.csv k_axial_N_mm: point 7: 4 N/mm, 5 N/mm follows",
        ),
        (
            (LOST, PROGRAMS, VERDICT, TIMES),
            "trajectory.csv: cannot be read: No such file or directory",
            "  because of that also: robot programs, result.json verdict, result.json times",
        ),
        (
            (JERK, INDEX),
            "trajectory.csv, index of the samples: 4 mm, the limit is 0.02, at sample 766, point 8.000",
            "  also trajectory.csv, joint jerk: 2.577 of the limit, the limit is 1.1, at axis 2, sample 775",
        ),
        ((VERDICT,), f"result.json verdict: {SAID}", f"result.json verdict: {SAID}"),
    ],
)
def test_first_line_states_the_cause(checks: tuple[VerificationCheck, ...], first: str, last: str) -> None:
    lines = format_failures(checks).split("\n")
    assert lines[0] == first
    assert lines[-1] == last
    assert sort_causes_first((OK, *checks))[-1] is OK


def test_values_are_formatted_as_in_the_file() -> None:
    assert format_json_value(None) == "null"
    assert format_json_value(True) == "true"
    assert format_json_value("done") == '"done"'
    assert format_json_value(0.1 + 0.2) == "0.3"
    assert format_json_value(np.float64(2.5)) == "2.5"
    assert "Covered" not in format_json_value((CheckCoverage("path", "every sample"),))
    assert format_json_value({"a": np.arange(2)}) == '{"a": [0, 1]}'
