"""Every check that verify can print has a damage, or a condition that is removed here, which makes it fail."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from output_damage.damage_case import JOBS, Damage, Job, build_table_change, copy_job, update_manifest_hashes
from test_output_damage_detection import DAMAGES, _of_manifest, _remembered, found_in  # noqa: F401

from machopt.cell.cell_reader import load_cell
from machopt.verification import VerificationCheck, VerificationInformation
from machopt.verification.checks import Verification
from machopt.verification.motion.collision.bodies import build_bodies, list_checked_pairs
from machopt.verification.motion.collision.urdf_inventory import check_inventory
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

CELL = Path(__file__).parents[1] / "cells" / "kr500_milling"
INVENTORY = {"bodies of the URDF", "joints and masses of the URDF", "bodies checked for contacts"}
MANIFEST = {"manifest.json"}  # its seal and form: the rows of MANIFESTS in tests/output_damage/folder_damage.py


def _in_dwell(rows: list[dict[str, str]]) -> None:
    joints = [f"q{j}_deg" for j in range(1, 7)]
    still = [k for k in range(1, len(rows) - 1) if all(rows[k][c] == rows[k - 1][c] == rows[k + 1][c] for c in joints)]
    for k in still:
        rows[k]["q1_deg"] = f"{float(rows[k]['q1_deg']) + 0.01:.6f}"


def _longer(rows: list[dict[str, str]]) -> None:
    for row in rows:
        row["dwell_s"] = "9.5"


def _jump(rows: list[dict[str, str]]) -> None:
    for row in rows[len(rows) // 2 :]:
        row["q6_deg"] = f"{float(row['q6_deg']) + 10.0:.6f}"


OWN = [
    Damage(
        "trajectory.csv joint 6 jumps", "10°", build_table_change("trajectory.csv", _jump), "joint velocity", "in krl"
    ),
    Damage("points.csv dwell", "+8 s", build_table_change("points.csv", _longer), "points.csv dwell_s", "in krl"),
    Damage(
        "trajectory.csv moves while it dwells",
        "0.01°",
        build_table_change("trajectory.csv", _in_dwell),
        "dwells",
        "in krl",
    ),
]


@pytest.mark.proof
def test_every_check_of_the_jobs_can_fail(
    damage_job: Callable[[str], Job],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """All names are collected from intact outputs of all jobs; the damages are tried until each has failed.

    First come those of which a row says that a check that is lacking finds them, then all others.
    """
    jobs = {name: damage_job(name) for name in JOBS}
    intact = {name: found_in(job) for name, job in jobs.items()}
    names = {str(c.check_name) for found in intact.values() for c in found.checks}
    information = {i.check_name for found in intact.values() for i in found.information}
    assert information
    assert not names & information
    lacking = names - INVENTORY - MANIFEST
    damages = [d for d in (*OWN, *DAMAGES) if d.reseal and not d.by_hash_alone]
    others = []
    for expected, damage in itertools.chain(((True, d) for d in damages), ((False, d) for d in others)):
        if not lacking:
            break
        if expected and not any(n.startswith(damage.caught_by) or n == damage.as_is for n in lacking):
            others.append(damage)
            continue
        job = copy_job(jobs[damage.job], tmp_path_factory.mktemp("damaged"))
        damage.apply(job)
        lacking -= {c.name for c in _of_manifest(job) if c.passed is False}
        update_manifest_hashes(job.out)
        lacking -= {str(c.check_name) for c in found_in(job).failed}
    assert lacking <= set(), lacking


@pytest.mark.parametrize("name", sorted(INVENTORY))
def test_the_inventory_can_fail(name: str) -> None:
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
