"""Data type of a damage, the damaged jobs, and the update of the manifest after a damage."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.output import MANIFEST
from machopt.output.file_hashes import compute_sha256
from machopt.output.manifest_file import compute_seal, list_folder_files

ROOT = Path(__file__).resolve().parents[2]
CELLS = ROOT / "cells"


@dataclass(frozen=True)
class Job:
    """A finished plan and its inputs."""

    cell: Path
    toolpath: Path
    out: Path
    posts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Damage:
    """One row of a table."""

    name: str  # unique among all rows
    how_much: str  # the size of the damage, in words
    apply: Callable[[Job], None]  # changes the copy ``job.out`` (or the copies of cell and toolpath)
    caught_by: str  # name (or its beginning) of the check that fails after the hashes are updated
    job: str = "pass"  # the job of JOBS that is damaged
    by_hash_alone: bool = False  # the content has no other check (report.html)
    reseal: bool = True  # False: the damage concerns the manifest or the inputs, so hashes are not updated
    as_is: str = "files as listed"  # the check that detects it without updated hashes


HEADER = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"
# a short cut over the cylinder head with a corner, approach and retract at feed
PASS: tuple[tuple[float, float, float, str, str], ...] = (
    (-100, 0, 60, "rapid", ""),
    (-100, 0, 5, "approach", "1000"),
    *((-100 + 4.0 * i, 0, -0.5, "cut", "1500") for i in range(4)),
    *((-88, 4.0 * i, -0.5, "cut", "1200") for i in range(1, 3)),
    (-88, 8, 5, "retract", "1000"),
    (-88, 8, 60, "rapid", ""),
)


def plan_pass(folder: Path) -> Job:
    """Plan the pass in the milling cell with the cell's own post."""
    return plan_table(folder, CELLS / "kr500_milling", PASS)


def plan_table(
    folder: Path,
    cell: Path,
    rows: Sequence[tuple[float, float, float, str, str]],
    *,
    posts: tuple[str, ...] = (),
    overrides: tuple[str, ...] = (),
) -> Job:
    """Plan a table of (x, y, z, move, feed) with the tool vertical, in copies of cell and table."""
    toolpath = folder / "pass.csv"
    toolpath.write_text(HEADER + "\n" + "".join(f"{x},{y},{z},0,0,1,{move},{feed}\n" for x, y, z, move, feed in rows))
    shutil.copytree(cell, folder / "cell")
    job = Job(folder / "cell", toolpath, folder / "out", posts)
    coarse = ("rotation_step_deg=15", *overrides)  # the plan must be valid, not optimal
    outcome = run_optimize(
        OptimizeRequest(cell=job.cell, toolpath=toolpath, out=job.out, overrides=coarse, posts=posts)
    )
    assert outcome.exit_code == 0, outcome.result.to_json_types()["verification"]
    return job


INVENTORY = {"bodies of the URDF", "joints and masses of the URDF", "bodies checked for contacts"}
"""Checks that no damage of a folder makes fail: tests/test_verify_every_check_can_fail.py removes their inputs."""
MANIFEST_CHECK = {"manifest.json"}
"""Checks of the manifest's seal and format: the rows of MANIFESTS in folder_damage.py."""

JOBS: dict[str, Callable[[Path], Job]] = {"pass": plan_pass}
"""Each job is planned once per session; a module that needs another job adds it here."""


def copy_job(job: Job, folder: Path) -> Job:
    """Copy the job, including its inputs, so that it can be damaged."""
    shutil.copytree(job.cell, folder / "cell")
    shutil.copytree(job.out, folder / "out")
    shutil.copy(job.toolpath, folder / job.toolpath.name)
    return Job(folder / "cell", folder / job.toolpath.name, folder / "out", job.posts)


def update_manifest_hashes(out: Path, known: Mapping[str, str] | None = None) -> None:
    """Update the hashes of result.json and the manifest to the files in the folder.

    Args:
        out: the output folder.
        known: SHA-256 of unchanged files, by name.
    """
    known = known or {}
    hashes = {name: known.get(name) or compute_sha256(out / name) for name in list_folder_files(out) - {MANIFEST}}
    with edit_json(out / "result.json") as result:
        result["outputs"] = {name: hashes[name] for name in sorted(hashes.keys() - {"result.json"})}
    if "result.json" in hashes:
        hashes["result.json"] = compute_sha256(out / "result.json")
    with edit_json(out / MANIFEST) as manifest:
        roles = {name: item["role"] for name, item in manifest["files"].items()}
        manifest["files"] = {
            name: {
                "role": roles.get(name, "other"),
                "sha256": hashes[name],
                "size": (out / name).stat().st_size,
            }
            for name in sorted(hashes)
        }
        manifest["seal"] = compute_seal(manifest)


@contextmanager
def edit_json(file: Path) -> Iterator[dict[str, Any]]:
    """Yield a JSON file as a dictionary and write it back; a missing or invalid file is not changed."""
    try:
        value = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        value = None
    if not isinstance(value, dict):
        yield {"files": {}}
        return
    yield value
    file.write_text(json.dumps(value, ensure_ascii=False) + "\n", encoding="utf-8", newline="\n")


def build_json_change(name: str, change: Callable[[dict[str, Any]], None]) -> Callable[[Job], None]:
    """Return a damage that changes a JSON file of the folder."""

    def apply(job: Job) -> None:
        with edit_json(job.out / name) as value:
            change(value)

    return apply


def build_table_change(name: str, change: Callable[[list[dict[str, str]]], None]) -> Callable[[Job], None]:
    """Return a damage that changes rows of a CSV table of the folder; a row is a dictionary of strings by column."""

    def apply(job: Job) -> None:
        file = job.out / name
        lines = file.read_text(encoding="utf-8").splitlines()
        comments = [line for line in lines if line.startswith("#")]
        reader = csv.DictReader(line for line in lines if not line.startswith("#"))
        rows = list(reader)
        change(rows)
        text = io.StringIO()
        writer = csv.DictWriter(text, reader.fieldnames or (), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        file.write_text("".join(f"{c}\n" for c in comments) + text.getvalue(), encoding="utf-8", newline="\n")

    return apply


def build_text_change(name: str, old: str, new: str) -> Callable[[Job], None]:
    """Return a damage that replaces the first ``old`` in a file of the folder; ``*.src`` means the only file of that
    type."""

    def apply(job: Job) -> None:
        file = find_single_file(job.out, name)
        text = file.read_bytes().decode("utf-8")
        assert old in text, f"{file.name} holds no {old!r}"
        file.write_bytes(text.replace(old, new, 1).encode("utf-8"))

    return apply


def find_single_file(folder: Path, pattern: str) -> Path:
    """Return the only file that matches the pattern."""
    (found,) = folder.rglob(pattern)
    return found
