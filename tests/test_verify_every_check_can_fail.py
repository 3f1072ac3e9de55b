"""Checks fail if their condition is removed; information never fails.

tests/test_output_damage_detection.py shows for every other check a damage that makes it fail.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from output_damage.damage_case import INVENTORY

from machopt.cell.cell_reader import load_cell
from machopt.verification import VerificationCheck, VerificationInformation
from machopt.verification.check_results import Verification
from machopt.verification.motion.collision.bodies import build_bodies
from machopt.verification.motion.collision.checked_pairs import list_checked_pairs
from machopt.verification.motion.collision.urdf_inventory import check_inventory
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

CELL = Path(__file__).parents[1] / "cells" / "kr500_milling"


@pytest.mark.parametrize("name", sorted(INVENTORY))
def test_listed_checks_can_fail(name: str) -> None:
    cell = load_cell(CELL)
    arm = UrdfKinematics(cell)
    bodies = build_bodies(cell, arm)
    checked = list_checked_pairs(cell, arm, bodies)
    assert all(c.passed for c in check_inventory(cell, arm, bodies, checked))
    if name == "bodies of the URDF":
        found = check_inventory(cell, arm, [b for b in bodies if "link" not in b.name], checked)
    elif name == "bodies checked for contacts":
        found = check_inventory(cell, arm, bodies, checked[: len(checked) // 2])
    else:
        arm.model.inertias[3].mass += 7.0
        found = check_inventory(cell, arm, bodies, checked)
    assert {c.name: c.passed for c in found}[name] is False


def test_information_is_no_check() -> None:
    check = VerificationCheck(name="path", passed=True, value=0.0, limit=1.0, unit="mm", where="")
    stated = VerificationInformation(name="depth", value=3.0, unit="mm", where="row 1")
    found = Verification.from_rows([check, stated], 1, 0.0)
    assert (found.checks, found.information, found.ok) == ((check,), (stated,), True)
    assert replace(found, checks=(replace(check, passed=False),)).failed
    assert not hasattr(stated, "passed")
