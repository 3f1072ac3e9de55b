"""Robot programs: speed and random round trips, for every post (damaged files: ``fuzz_readers.py``).

Run: ``python benchmarks/post_round_trips.py [--moves N] [--paths N] [POST …]``. Prints how long a program of N moves
takes to write and to read back; makes ``--paths`` random valid paths for every post and takes each from CSV to program
and back to CSV within the printed decimals.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from sample_robot_programs import MAPPED, PLAIN, Recipe, program  # noqa: E402
from test_post_roundtrip import csv_round_trip, main_file  # noqa: E402

from machopt.programs.program_reader import read_program  # noqa: E402
from machopt.programs.program_writer import format_program_name, list_post_names, write_program  # noqa: E402

LABELS = ("drill", "face 2", "A", "x y z", "op-1")


def speed(moves: int, posts: list[str]) -> None:
    p = program(Recipe(1, moves=moves, blend=1e-4, events=20), MAPPED)
    for post in posts:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            start = time.perf_counter()
            files = write_program(folder, format_program_name("part", post), p, post, MAPPED)
            middle = time.perf_counter()
            parsed = read_program(folder / main_file(post, format_program_name("part", post)))
            end = time.perf_counter()
            size = sum(f.stat().st_size for f in files) / 1e6
            print(
                f"{post:16} {moves} moves: written {middle - start:.2f} s, {size:.1f} MB in {len(files)} files, "
                f"read {end - middle:.2f} s, {len(parsed)} moves"
            )


def paths(count: int, posts: list[str]) -> None:
    rng = np.random.default_rng(20_260)
    for post in posts:
        start = time.perf_counter()
        with tempfile.TemporaryDirectory() as name:
            for n in range(count):
                labels = tuple(rng.choice(LABELS, rng.integers(1, 4), replace=False))
                recipe = Recipe(
                    seed=int(rng.integers(2**32)),
                    moves=int(rng.integers(2, 40)),
                    blend=float(rng.choice([0, 1e-4, 1e-2])),
                    slowest=2e-4,
                    feeds=int(rng.integers(1, 5)),
                    operations=labels,
                    events=int(rng.integers(0, 5)),
                )
                csv_round_trip(recipe, post, (PLAIN, MAPPED)[n % 2], Path(name))
        print(f"{post:16} {count} random paths came back within print, {time.perf_counter() - start:.0f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moves", type=int, default=0)
    parser.add_argument("--paths", type=int, default=0)
    parser.add_argument("posts", nargs="*", help="all by default")
    args = parser.parse_args()
    if args.moves:
        speed(args.moves, args.posts or list(list_post_names()))
    if args.paths:
        paths(args.paths, args.posts or list(list_post_names()))


if __name__ == "__main__":
    main()
