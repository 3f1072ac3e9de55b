"""Several toolpaths as a batch on Dask, each in a process of its own; called again, it goes on where it stopped.

``python docs/examples/batch_on_dask.py OUT`` (``scheduler="tcp://…"`` would use a cluster that is running already)
"""

import sys
from pathlib import Path

import machopt

ROOT = Path(__file__).resolve().parents[2]


def main(out: Path) -> None:
    parts = out / "parts"
    parts.mkdir(parents=True, exist_ok=True)
    for n, y in enumerate((-40, 40)):
        rows = [
            f"{x},{y},{z},0,0,1,{move},600" for x, z, move in [(0, 30, "approach"), (0, -2, "cut"), (60, -2, "cut")]
        ]
        (parts / f"slot_{n}.csv").write_text("x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n" + "\n".join(rows) + "\n")
    result = machopt.batch(
        parts,
        out / "batch",
        cell=ROOT / "cells" / "kr500_milling",
        workers=1,
        overrides=["rotation_step_deg=15"],
        progress=lambda p: print(p.status_line),
    )
    print(dict(result.counts))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
