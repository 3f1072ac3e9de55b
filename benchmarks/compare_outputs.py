"""Compare what two checkouts write for every shipped job and recording.

    python benchmarks/compare_outputs.py OLD_CHECKOUT [NEW_CHECKOUT] [--work DIR] [--job NAME …] [--recordings DIR]

Each checkout needs its own ``.venv``. Tables and robot programs are compared byte by byte (comment lines that carry the
version or the date excepted), JSON documents by their keys, numbers and code words. Sentences may differ. Exit status 1
where something else differs. A folder that exists in ``--work`` is not computed again, so that an old side is reused.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
JOBS: dict[str, list[str]] = {
    "deck": ["optimize", "cells/kr500_milling", "toolpaths/cylinder_head_face.cls"],
    "contour": ["optimize", "cells/kr500_milling", "toolpaths/contour_5axis.nc"],
    "plain": ["optimize", "cells/kr500_milling", "toolpaths/plain.csv", "--front"],
    "panel": ["optimize", "cells/kr240_drilling", "toolpaths/panel_holes.aptsource", "--compensate"],
    "plate": ["optimize", "cells/irb6700_drilling", "toolpaths/plate_holes.csv"],
    "castings": ["optimize", "cells/s420f_handling", "toolpaths/castings.csv"],
    "bone": ["optimize", "cells/cutting_cobot", "toolpaths/bone_tracks.csv"],
    "beam": ["optimize", "cells/kr500_rail", "toolpaths/beam_passes.csv"],
    "drum": ["optimize", "cells/kr240_turntable", "toolpaths/drum_holes.csv"],
    "setups": ["optimize", "cells/kr240_setups", "toolpaths/two_plates.nc"],
    "map": ["map", "cells/kr500_milling"],
    "poses": ["plan-poses", "cells/kr240_drilling"],
    "identify": ["identify", "cells/irb6700_drilling", "cells/irb6700_drilling/recordings/zhang2025_table2"],
    "diagnose-zhang": ["diagnose", "cells/irb6700_drilling", "cells/irb6700_drilling/recordings/zhang2025_table2"],
    "diagnose-tian": ["diagnose", "cells/cutting_cobot", "cells/cutting_cobot/recordings/tian2025_table2"],
}
# Keys that hold sentences, times of the run or versions: everything else has to be equal.
TEXT_KEYS = re.compile(
    r"(sentence|message|text|note|warning|hint|reason_text|advice|title|label|summary|said|told|detail|what|why|version|started|finished|seconds|sha256|"
    r"_at$|created|duration_of_run|command|host|python|platform|cpu|memory|path|folder|headline|next)"
)
SKIPPED = re.compile(
    r"\.timings|manifest\.json\.files|\.seal$|\.outputs\.(report|map|place|summary)[^.]*\.(html|svg)|\.html$"
)
BINARY = (".parquet", ".html", ".svg", ".png")


def run_job(checkout: Path, words: list[str], out: Path) -> None:
    """Run one command of a checkout into ``out`` and keep its exit status beside it."""
    status = out.parent / f"{out.name}.exit"
    if status.exists():
        return
    inputs = [str(checkout / w) if w.startswith(("cells/", "toolpaths/")) else w for w in words]
    done = subprocess.run(
        [checkout / ".venv/bin/machopt", *inputs, "-o", str(out), "--quiet"],
        check=False,
        cwd=out.parent,
        capture_output=True,
        text=True,
    )
    status.write_text(f"{done.returncode}\n")


def find_json_differences(old: object, new: object, key: str = "") -> list[str]:
    """List the keys whose numbers, code words or structure differ."""
    last = key.rsplit(".", 1)[-1]
    if TEXT_KEYS.search(last) or SKIPPED.search(key):
        return []
    if isinstance(old, dict) and isinstance(new, dict):
        names = sorted(set(old) | set(new))
        return [
            d
            for n in names
            for d in (
                [f"{key}.{n}: only on one side"]
                if (n in old) != (n in new)
                else find_json_differences(old[n], new[n], f"{key}.{n}")
            )
        ]
    if isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            return [f"{key}: {len(old)} and {len(new)} entries"]
        return [
            d for i, (a, b) in enumerate(zip(old, new, strict=True)) for d in find_json_differences(a, b, f"{key}[{i}]")
        ]
    if (
        isinstance(old, float)
        and isinstance(new, float)
        and (math.isclose(old, new, rel_tol=1e-9, abs_tol=1e-12) or (math.isnan(old) and math.isnan(new)))
    ):
        return []
    if isinstance(old, str) and isinstance(new, str) and " " in old and " " in new:
        return []  # a sentence
    return [] if old == new else [f"{key}: {old!r} and {new!r}"]


def find_file_differences(old: Path, new: Path) -> list[str]:
    """List what differs between two files of the same name."""
    if old.suffix == ".json":
        return find_json_differences(json.loads(old.read_text()), json.loads(new.read_text()), old.name)
    a, b = old.read_text(errors="replace").splitlines(), new.read_text(errors="replace").splitlines()
    comment = re.compile(r"machopt|\b20\d\d-\d\d-\d\d\b|^\s*#|^\s*;|^\s*!|^\s*//")
    a, b = ([line for line in lines if not comment.search(line)] for lines in (a, b))
    if a == b:
        return []
    at = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
    return [f"{old.name}: differs at line {at + 1} of {len(a)} and {len(b)}: {a[at : at + 1]} and {b[at : at + 1]}"]


def compare_folders(old: Path, new: Path) -> list[str]:
    """List what differs between two output folders."""
    files = [{str(p.relative_to(side)) for p in side.rglob("*") if p.is_file()} for side in (old, new)]
    found = [f"{name}: only on one side" for name in sorted(files[0] ^ files[1])]
    for name in sorted(files[0] & files[1]):
        if not name.endswith(BINARY):
            found += find_file_differences(old / name, new / name)
    return found


def main() -> int:
    """Run and compare; return 1 where outputs differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path, nargs="?", default=ROOT)
    parser.add_argument("--work", type=Path, default=Path("out/compare_outputs"))
    parser.add_argument("--job", action="append", default=[])
    parser.add_argument(
        "--recordings", type=Path, help="folder of further CELL/recording pairs: NAME/cell and NAME/recording"
    )
    parser.add_argument("--old-only", action="store_true", help="compute the old side and stop")
    args = parser.parse_args()
    jobs = dict(JOBS)
    if args.recordings:
        pairs = sorted(
            p for p in args.recordings.resolve().iterdir() if (p / "cell").is_dir() and (p / "recording").is_dir()
        )
        jobs |= {f"diagnose-{p.name}": ["diagnose", str(p / "cell"), str(p / "recording")] for p in pairs}
    differing = 0
    for name, words in jobs.items():
        if args.job and name not in args.job:
            continue
        sides = []
        for side, checkout in (("old", args.old), ("new", args.new)):
            if side == "new" and args.old_only:
                continue
            folder = (args.work / side).resolve()
            folder.mkdir(parents=True, exist_ok=True)
            run_job(checkout.resolve(), words, folder / name)
            sides.append(folder)
        if args.old_only:
            continue
        exits = [(side / f"{name}.exit").read_text().strip() for side in sides]
        found = [f"exit status {exits[0]} and {exits[1]}"] if exits[0] != exits[1] else []
        if all((side / name).is_dir() for side in sides):
            found += compare_folders(sides[0] / name, sides[1] / name)
        print(f"{name}: exit {exits[0]}, " + (f"{len(found)} differences" if found else "same"), flush=True)
        for line in found[:10]:
            print("   ", line)
        differing += bool(found)
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main())
