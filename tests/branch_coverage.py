"""Branch coverage by package from ``.coverage``; ``make coverage`` fails below FLOOR.

The tracer does not count functions compiled by numba (each is compared with NumPy or exhaustive search by its own test)
and code in processes that a test starts.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

FLOOR = {  # minimum branch coverage in % by folder
    "planning": 90.0,
    "collision": 90.0,
    "dynamics": 90.0,
    "kinematics": 90.0,
    "stiffness": 90.0,
    "effects": 90.0,
    "measurement/identification": 90.0,
    "measurement/diagnosis": 90.0,
    "measurement/estimation": 95.0,
}
ROOT = Path(__file__).resolve().parents[1] / "machopt"


@dataclass(frozen=True)
class BranchCount:
    """Number of branches of a package or a file."""

    name: str
    taken: int
    all: int

    @property
    def share(self) -> float:
        """Branch coverage in percent."""
        return 100.0 * self.taken / self.all if self.all else 100.0


def package_of(file: str) -> str:
    """Return the folder of FLOOR that contains the file, else its first folder."""
    return next((name for name in FLOOR if file.startswith(name + "/")), file.partition("/")[0])


def sum_by_package(files: Iterable[BranchCount]) -> list[BranchCount]:
    """Sum the branches of files (named by their path under machopt/) by package."""
    sums: defaultdict[str, list[int]] = defaultdict(lambda: [0, 0])
    for f in files:
        sums[package_of(f.name)][0] += f.taken
        sums[package_of(f.name)][1] += f.all
    return [BranchCount(name, taken, every) for name, (taken, every) in sorted(sums.items())]


def find_packages_below_floor(packages: Iterable[BranchCount]) -> list[str]:
    """Return messages for packages below their floor, and for existing packages that were not measured."""
    found = {p.name: p for p in packages}
    there = [name for name in FLOOR if name in found or (ROOT / name).is_dir()]
    missing = [f"{name} was not measured" for name in there if name not in found]
    low = [p for name, p in found.items() if name in FLOOR and p.share < FLOOR[name]]
    return missing + [f"{p.name}: {p.share:.1f} % of {p.all} branches, less than {FLOOR[p.name]:g} %" for p in low]


def read_branch_counts() -> list[BranchCount]:
    """Return the branches of every file of machopt that coverage measured."""
    from coverage import Coverage

    data = Coverage(config_file=str(ROOT.parent / "pyproject.toml"))
    data.load()
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "coverage.json"
        data.json_report(outfile=str(report))
        files = json.loads(report.read_text(encoding="utf-8"))["files"]
    mine = {(ROOT.parent / name).resolve(): f["summary"] for name, f in files.items()}
    return [
        BranchCount(path.relative_to(ROOT).as_posix(), found["covered_branches"], found["num_branches"])
        for path, found in sorted(mine.items())
        if path.is_relative_to(ROOT)
    ]


def main() -> int:
    files = read_branch_counts()
    packages = sum_by_package(files)
    for p in packages:
        print(f"{p.name:26} {p.share:5.1f} % of {p.all} branches" + (" *" if p.name in FLOOR else ""))  # noqa: T201
    for f in sorted((f for f in files if package_of(f.name) in FLOOR), key=lambda f: f.taken - f.all)[:15]:
        print(f"  {f.all - f.taken:3} branches not taken in {f.name}")  # noqa: T201
    wrong = find_packages_below_floor(packages)
    for line in wrong:
        print(line, file=sys.stderr)  # noqa: T201
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
