"""benchmarks/second_cam_reader and cam_reader_comparison.py: two independent readers agree on handwritten programs."""

from __future__ import annotations

import ast
import random
import sys
from pathlib import Path

import numpy as np
import pytest
from dialect_writers import DIALECTS, Leg

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import cam_reader_comparison  # noqa: E402  # benchmarks is no package

RAPID = float("nan")


def path(*, arcs: bool) -> list[Leg]:
    """Return a path of a rapid move, a plunge, a square corner, a quarter and a three-quarter circle, and a retract."""
    at = [
        np.array(p, dtype=float)
        for p in ((0, 0, 20), (0, 0, -1), (30, 0, -1), (40, 10, -1), (40, 50, -1), (40, 50, 20))
    ]
    legs = [Leg(np.zeros(3), at[0], RAPID), Leg(at[0], at[1], 200.0), Leg(at[1], at[2], 900.0)]
    if arcs:
        legs.append(Leg(at[2], at[3], 900.0, (17, np.array([30.0, 10.0, -1.0]), 90.0)))
        back = np.array([60.0, 30.0, -1.0])
        legs.append(Leg(at[3], back, 450.0, (17, np.array([60.0, 10.0, -1.0]), 270.0)))
        legs.append(Leg(back, at[4], 900.0))
    else:
        legs += [Leg(at[2], at[3], 900.0), Leg(at[3], at[4], 450.0)]
    return [*legs, Leg(at[4], at[5], RAPID), Leg(at[5], at[5] + [5.0, 0.0, 0.0], 900.0)]


def write(folder: Path, name: str, seed: int = 1) -> Path:
    d = DIALECTS[name]
    file = folder / f"a{d.suffix}"
    file.write_text("\n".join(d.write(path(arcs=d.arcs), random.Random(seed)).lines) + "\n")
    return file


@pytest.mark.parametrize("name", [n for n in DIALECTS if n != "hsm"])  # the second reader does not support MOVARC
def test_both_readers_agree(tmp_path: Path, name: str) -> None:
    verdict = cam_reader_comparison.judge(write(tmp_path, name), name)
    assert (verdict.refused, verdict.second, verdict.differs) == ("", "", []), verdict
    assert verdict.ends == len(path(arcs=DIALECTS[name].arcs))


def test_comparison_detects_a_shifted_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The comparison can fail: the second reader reads a file in which one coordinate is changed."""
    file = write(tmp_path, "krl")
    read = cam_reader_comparison.second_cam_reader.read

    def elsewhere(f: Path) -> cam_reader_comparison.Path3:
        text = f.read_text().replace("60.0", "60.1").replace("60.,", "60.1,").replace("X 60,", "X 60.1,")
        (tmp_path / "b.src").write_text(text)
        return read(tmp_path / "b.src")

    monkeypatch.setattr(cam_reader_comparison.second_cam_reader, "read", elsewhere)
    assert {"ends", "path"} <= set(cam_reader_comparison.judge(file, "krl").differs)


def test_second_reader_imports_nothing_of_the_first() -> None:
    for file in (BENCHMARKS / "second_cam_reader").glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(n.split(".")[0] == "machopt" for n in names), file.name
