"""Writes the five example cells: URDF, meshes, cell.yaml and stiffness.yaml of each; the READMEs are by hand.

Run ``python cells/make_cells.py [cell …]``. The output is deterministic and committed; edit ``making/``, never there.
Link shapes are our own envelopes, drawn from published kinematic dimensions.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from making.cellfiles import CellFiles
from making.cobot import cutting_cobot
from making.irb6700 import irb6700_drilling
from making.kr240 import kr240_drilling
from making.kr500 import kr500_milling
from making.s420f import s420f_handling
from making.written import write_cell

HERE = Path(__file__).resolve().parent
CELLS: dict[str, Callable[[], CellFiles]] = {
    "kr500_milling": kr500_milling,
    "kr240_drilling": kr240_drilling,
    "irb6700_drilling": irb6700_drilling,
    "s420f_handling": s420f_handling,
    "cutting_cobot": cutting_cobot,
}

if __name__ == "__main__":
    for wanted in sys.argv[1:] or CELLS:
        write_cell(CELLS[wanted](), HERE)
        print(HERE / wanted)
