"""Speed of ``machopt map`` on the shipped cells: ``python benchmarks/workspace_map_time.py``.

Prints for the default slice, a volume and dumas2011's joint plane the wall time, the samples a second, and the poses
(samples × rotations) a second that inverse kinematics, stiffness and the collision check got through together.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from time import perf_counter

from machopt.commands.map.run import MapRequest, run_map

CELLS = Path(__file__).resolve().parents[1] / "cells"
MAPS: dict[str, tuple[str, dict[str, object]]] = {
    "KR240, default slice": ("kr240_drilling", {}),
    "KR240, default slice, no collision check": ("kr240_drilling", {"collision": "none"}),
    "KR240, slice under load, whole cell checked": ("kr240_drilling", {"force": "0,0,-1000", "collision": "cell"}),
    "KR240, default volume": ("kr240_drilling", {"volume": True}),
    "KR240, joints 2 and 3 (dumas2011)": (
        "kr240_drilling",
        {"joints": "a2,a3", "q": "a1=0,a4=45,a5=45,a6=45", "wrench": "0,0,-2000,200,200,0"},
    ),
    "KR240, line of 1.7 m": ("kr240_drilling", {"line": "800,-400,700:2200,600,900"}),
    "KR500, default slice": ("kr500_milling", {}),
    "UR-like cobot, default slice": ("cutting_cobot", {}),
}


def main() -> None:
    print(f"{'map':46} {'samples':>8} {'time s':>7} {'samples/s':>10} {'poses/s':>10}")
    for name, (cell, asked) in MAPS.items():
        with tempfile.TemporaryDirectory() as folder:
            start = perf_counter()
            outcome = run_map(MapRequest(cell=CELLS / cell, out=Path(folder) / "out", **asked))  # type: ignore[arg-type]
            seconds = perf_counter() - start
        told = outcome.result.to_json_types()
        samples, options = told["samples"], told["options"]
        rotations = options["rotations"]  # type: ignore[index]
        poses = samples * (1 if rotations is None else rotations + 1)  # type: ignore[operator]
        print(f"{name:46} {samples:8,} {seconds:7.2f} {samples / seconds:10,.0f} {poses / seconds:10,.0f}")  # type: ignore[operator]


if __name__ == "__main__":
    main()
