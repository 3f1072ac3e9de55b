"""Recompute the errors that ``machopt diagnose`` states, from its output files alone.

``python benchmarks/recompute_diagnosis_errors.py CELL OUT RECORDING`` reads the cell and, from OUT, the model files,
the corrected readings and the folds. It prints stated and recomputed ``final.rmse`` and ``final.heldout_rmse``, and
ends with 4 where they differ by more than 0.1 %. The recording is read to count its readings: fewer corrected rows are
an error too.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from machopt.cell.cell_reader import load_cell
from machopt.commands.diagnose.model_files import PRINTED_MM, TOLERANCE, read_assessment
from machopt.data_types.cell import Cell
from machopt.measurement.recording import load_recording
from machopt.numerics.rigid_transforms import build_transform


def place_tool(cell: Cell, document: dict) -> Cell:
    """Return the cell with the TCP that the findings state."""
    for f in document["findings"]:
        if f["effect"] == "load_geometry" and {"offset_x", "offset_y", "offset_z"} <= f["parameters"].keys():
            if "TCP" not in f["law"]:
                continue
            offset = [1e-3 * f["parameters"][f"offset_{a}"]["value"] for a in "xyz"]
            T = cell.tool.T_flange_tcp @ build_transform(np.eye(3), np.array(offset))
            cell = replace(cell, tool=replace(cell.tool, T_flange_tcp=T))
    return cell


def main() -> int:
    """Compare both errors; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("cell", "out", "recording"):
        parser.add_argument(name, type=Path)
    args = parser.parse_args()
    document = json.loads((args.out / "diagnosis.json").read_text(encoding="utf-8"))
    recorded = load_recording(args.recording)
    cell = load_cell(args.cell, any_chain=any(recorded.prismatic), bodies=False)
    assessed = read_assessment(args.out, place_tool(cell, document))
    wrong = len(assessed.recording) != len(recorded)
    if wrong:
        print(f"readings_corrected.csv has {len(assessed.recording)} rows, the recording {len(recorded)}")
    for name, again in zip(("rmse", "heldout_rmse"), assessed.errors_mm, strict=True):
        stated = document["final"][name]
        same = abs(stated - again) <= TOLERANCE * stated + PRINTED_MM
        wrong = wrong or not same
        print(f"final.{name}: stated {stated:.6f} mm, of the files {again:.6f} mm{'' if same else '  DIFFERS'}")
    return 4 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
