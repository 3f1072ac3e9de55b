"""Mutated and truncated files, 100,000 a format: a clear refusal or a sane toolpath, never a crash, never a hang.

Run: ``python benchmarks/fuzz_readers.py [--cases 100000] [--minutes M] [--seed S] [FORMAT …]``. The formats take turns,
a stretch of cases each, so that a limit of time is shared among them; stretch k of a format is the same files for the
same seed. A failing stretch is told with its file and its traceback, and the others go on. Exit code 1 if any failed.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import program_mutations  # noqa: E402
import test_fuzz_readers  # noqa: E402
import toolpath_file_samples as samples  # noqa: E402

STRETCH = 250  # cases
CAM = {
    "apt": (samples.NX, samples.CATIA, samples.CREO, samples.HSM, samples.CAMWORKS),
    "gcode": (samples.FANUC, samples.FIVE_AXES, samples.WITHOUT_TCP, samples.LINUXCNC),
    "siemens": (samples.SIEMENS,),
    "heidenhain": (samples.HEIDENHAIN,),
    "iso": (samples.DIN_ISO,),
    "nci": (samples.NCI,),
    "csv": (samples.TABLE, samples.POSES),
}
FORMATS = tuple(dict.fromkeys((*CAM, *program_mutations.FORMATS)))


class Format:
    """The cases of one format: its CAM samples and its programs in turn."""

    def __init__(self, name: str, place: Path) -> None:
        self.name, self.cases, self.failures, self.seconds = name, 0, 0, 0.0
        self.found: Counter[str] = Counter()
        self._place, self._stretch = place, 0
        self._turns: list[samples.Sample | Path] = list(CAM.get(name, ()))
        if name in program_mutations.FORMATS:
            self._turns += program_mutations.seeds(place, name)

    def go_on(self, most: int, seed: int) -> None:
        """One more stretch."""
        what, k = self._turns[self._stretch % len(self._turns)], self._stretch
        count = min(STRETCH, most - self.cases)
        self._stretch, start = k + 1, time.perf_counter()
        try:
            if isinstance(what, Path):
                sound = {f: f.read_bytes() for f in what.rglob("*") if f.is_file()}
                found = program_mutations.run(what, count, random.Random(f"{seed} {self.name} {k}"))
            else:
                found = test_fuzz_readers.run(what, count, seed * 1_000_003 + k, self._place)
        except Exception:  # noqa: BLE001 – whatever a reader lets through is what is looked for
            self.failures += 1
            print(f"FAILED: {self.name}, stretch {k} of seed {seed}\n{traceback.format_exc()}", flush=True)
            if isinstance(what, Path):
                for file, data in sound.items():
                    if file.read_bytes() != data:
                        print(f"{file.name}:\n{file.read_bytes()!r}", flush=True)
                        file.write_bytes(data)
        else:
            slowest = max(self.found["slowest_ms"], found["slowest_ms"])
            self.found += found
            self.found["slowest_ms"] = slowest
            self.cases += count
        self.seconds += time.perf_counter() - start

    def __str__(self) -> str:
        f = self.found
        return (
            f"{self.name:11}{self.cases:>8} damaged files: {f['read']:>6} read, {f['refused']:>6} refused, "
            f"{self.failures} failures; slowest {f['slowest_ms'] / 1e3:.2f} s, {self.seconds:.0f} s in all"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=", ".join(FORMATS))
    args = parser.parse_args()
    if set(args.formats) - set(FORMATS):
        parser.error(f"known are {', '.join(FORMATS)}")
    end = time.monotonic() + 60.0 * args.minutes
    with tempfile.TemporaryDirectory() as name:
        formats = []
        for one in args.formats or FORMATS:
            place = Path(name) / one
            place.mkdir()
            formats.append(Format(one, place))
        while (open_ := [f for f in formats if f.cases < args.cases and f.failures < 5]) and time.monotonic() < end:
            nearest = min(open_, key=lambda f: f.seconds)  # an even share of the time
            nearest.go_on(args.cases, args.seed)
    for f in formats:
        print(f)
    return int(any(f.failures for f in formats))


if __name__ == "__main__":
    sys.exit(main())
