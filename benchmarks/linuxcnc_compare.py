"""machopt's G-code reader against LinuxCNC's interpreter, which shares no code with it.

Run: ``python benchmarks/linuxcnc_compare.py [--programs 2000] [--seed 0] [--files FOLDER] [--show N] [--save FOLDER]``.
Needs `rs274` (``apt-get install --no-install-recommends linuxcnc-uspace``). Random programs and, with ``--files``,
every .ngc file of a folder are read by both; each run of `rs274` has its own fresh parameter file. Where the points
differ, machopt must have said that controls differ ("noted"), or both refuse; all else is printed and ends with 1.
"""

from __future__ import annotations

import argparse
import collections
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from linuxcnc.point_comparison import Outcome, compare
from linuxcnc.random_programs import program

BAD = ("differ", "only machopt refuses", "only rs274 refuses")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--programs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--files", type=Path, help="a folder of programs, instead of random ones")
    parser.add_argument("--show", type=int, default=10, help="how many differences to print")
    parser.add_argument("--save", type=Path, help="where to write the programs that differ")
    args = parser.parse_args()
    named: list[tuple[str, str]]
    if args.files:
        named = [
            (str(f.relative_to(args.files)), f.read_text(encoding="latin-1")) for f in sorted(args.files.rglob("*.ngc"))
        ]
    else:
        named = [(f"seed {s}", program(s)) for s in range(args.seed, args.seed + args.programs)]
    counts: collections.Counter[str] = collections.Counter()
    shown = 0
    for name, text in named:
        found: Outcome = compare(text)
        counts[found.kind] += 1
        if found.kind in BAD:
            if shown < args.show:
                print(f"{name}: {found.kind}: {found.why}")
            shown += 1
            if args.save:
                args.save.mkdir(parents=True, exist_ok=True)
                (args.save / f"{name.replace('/', '_').replace(' ', '_')}.ngc").write_text(text, encoding="latin-1")
    print(f"{len(named)} programs: " + ", ".join(f"{n} {kind}" for kind, n in counts.most_common()))
    return int(any(counts[kind] for kind in BAD))


if __name__ == "__main__":
    sys.exit(main())
