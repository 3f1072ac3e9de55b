"""Damaged URDFs, meshes, cells, stiffness, recordings and options, 1,000 a format: refused or sane, never a crash.

Run: ``python benchmarks/fuzz_cells.py [--cases 1000] [--seed 2] [FORMAT …]``. Prints a table; a defect is told with
its traceback and the folder it is left in, and the others go on. Exit code 1 if there was any.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from cell_mutations import FORMATS, Case, run  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=", ".join(FORMATS))
    args = parser.parse_args()
    if set(args.formats) - set(FORMATS):
        parser.error(f"known are {', '.join(FORMATS)}")
    warnings.simplefilter("ignore", RuntimeWarning)  # of numbers that the libraries below meet before we refuse them
    lines, failures = [], 0
    with tempfile.TemporaryDirectory() as name:
        for one in args.formats or FORMATS:
            case, found = Case(one, Path(name)), Counter[str]()
            for k in range(args.cases):
                try:
                    found += run(case, 1, random.Random(f"{args.seed} {one} {k}"))
                except Exception:  # noqa: BLE001 – whatever a reader lets through is what is looked for
                    found["failed"] += 1
                    kept = Path(tempfile.mkdtemp(prefix=f"fuzz_{one}_"))
                    shutil.copytree(case.folder, kept, dirs_exist_ok=True)
                    print(f"FAILED: {one}, case {k} of seed {args.seed}, left in {kept}\n{traceback.format_exc()}")
            failures += found["failed"]
            lines.append(f"| {one} | {args.cases} | {found['refused']} | {found['read']} | {found['failed']} |")
    print("| format | damaged | refused | read, sane | internal errors |\n|---|---|---|---|---|")
    print("\n".join(lines))
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
