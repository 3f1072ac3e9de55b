"""Error on unseen poses over random growing subsets: ``python benchmarks/public_recordings/growing_subsets.py DATA
[--only rokae irb120] [--draws 20]``.

DATA holds a folder a set with ``cell`` and recordings of measured poses; nothing of them is stored in the project. For
each draw a quarter of the poses is set aside. The others, in random order, make subsets of growing size, each of which
contains the one before. Each subset is diagnosed. The written files then predict the poses that were set aside, with
the registration fitted to the subset. Printed are the medians over the draws for each size: the error and the ratio to
the error of the next smaller subset. More data must not give a worse model in the median.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np

from machopt.commands.diagnose.run import compute_diagnosis
from machopt.commands.recording_cell import load_recording_cell
from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.data_types.diagnosis_result import compute_rms
from machopt.measurement.diagnosis.outputs.corrected_recording import place_tool_where_found
from machopt.measurement.diagnosis.outputs.written_model_error import compute_written_residual
from machopt.measurement.diagnosis.request import DiagnoseRequest
from machopt.measurement.recording import load_recording
from machopt.measurement.recording.recording_writer import write_recording

SETS = {  # cell and recording, with the largest number of poses that a draw uses
    "rokae": ("rokae", "recording", 30),
    "irb120": ("irb120", "recording", 36),
    "irb120_more": ("irb120", "recording_more", 40),
    "fanuc36": ("fanuc36", "recording", 36),
    "ur5": ("ur5", "recording", 200),
    "ipa_ur10_d": ("ipa_ur10_d", "recording", 200),
}
UNSEEN = 0.25  # share of the poses that is set aside
SMALLEST = 0.45  # share of the other poses in the smallest subset
SEED = 38


@dataclass(frozen=True)
class SubsetResult:
    """Diagnosis of one subset."""

    draw: int
    poses: int
    error_mm: float  # rms per coordinate on the poses that were set aside
    stated_mm: float  # held-out error that the diagnosis states
    verdict: str
    names: tuple[str, ...]
    processor_s: float


def select_rows(recording: Recording, rows: np.ndarray) -> Recording:
    """Return some readings of a recording."""
    per_reading = {
        name: value[rows]
        for name, value in vars(recording).items()
        if isinstance(value, np.ndarray) and value.shape[:1] == (len(recording),)
    }
    return replace(recording, **per_reading)


def diagnose_subset(
    cell: Cell, cell_folder: Path, recording: Recording, seen: np.ndarray, unseen: np.ndarray
) -> tuple[float, float, str, tuple[str, ...]]:
    """Diagnose the seen poses; return unseen error and stated error in mm, verdict and names."""
    rows = np.flatnonzero(np.isin(recording.pose, seen))
    with tempfile.TemporaryDirectory() as name:
        write_recording(Path(name) / "recording", select_rows(recording, rows))
        request = DiagnoseRequest(cell=cell_folder, recordings=(Path(name) / "recording",), out=Path(name) / "out")
        done = compute_diagnosis(request, (), lambda _: None, cell)
    assert done.assessed is not None  # of measured poses
    fitted, wanted = np.zeros(len(recording), bool), np.isin(recording.pose, unseen)
    fitted[rows] = done.assessed.recording.used
    place = place_tool_where_found(cell, done.diagnosis.findings)
    residual = compute_written_residual(place, done.assessed.model, recording, fitted, wanted).values
    names = tuple(f"{f.effect} {f.location}" for f in done.diagnosis.findings)
    return 1e3 * compute_rms(residual), done.diagnosis.heldout_after, done.diagnosis.verdict, names


def run_set(name: str, data: Path, draws: range, steps: int) -> list[SubsetResult]:
    """Diagnose the growing subsets of all draws of one set."""
    folder, table, most = SETS[name]
    recording = load_recording(data / folder / table)
    cell = load_recording_cell(data / folder / "cell", recording)
    out = []
    for draw in draws:
        poses = np.random.default_rng([SEED, draw]).permutation(np.unique(recording.pose))[:most]
        unseen, others = np.split(poses, [round(UNSEEN * len(poses))])
        for size in np.unique(np.geomspace(SMALLEST * len(others), len(others), steps).round().astype(int)):
            start = process_time()
            found = diagnose_subset(cell, data / folder / "cell", recording, others[:size], unseen)
            one = SubsetResult(draw, int(size), *found, round(process_time() - start, 1))
            print(json.dumps([name, *vars(one).values()]), flush=True)
            out.append(one)
    return out


def print_medians(name: str, results: list[SubsetResult]) -> bool:
    """Print the medians of a set; return whether the error rises."""
    sizes = sorted({r.poses for r in results})
    errors = np.array([[r.error_mm for r in results if r.poses == size] for size in sizes])  # (sizes, draws)
    medians = np.median(errors, axis=1)
    steps = np.median(errors[1:] / errors[:-1], axis=1)
    print(f"{name}: {errors.shape[1]} draws")
    for k, size in enumerate(sizes):
        step = "" if k == 0 else f", ratio to the subset before {steps[k - 1]:.3f}"
        print(f"  {size:4d} poses: median {medians[k]:.4f} mm, largest {errors[k].max():.4f} mm{step}")
    return bool((np.diff(medians) > 0.0).any())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", nargs="*", default=list(SETS), choices=list(SETS))
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first draw")
    parser.add_argument("--steps", type=int, default=4, help="number of subsets of a draw")
    options = parser.parse_args()
    draws = range(options.first, options.first + options.draws)
    results = {name: run_set(name, options.data, draws, options.steps) for name in options.only}
    rising = [name for name, found in results.items() if print_medians(name, found)]
    print("the median rises: " + (", ".join(rising) or "in no set"))


if __name__ == "__main__":
    main()
