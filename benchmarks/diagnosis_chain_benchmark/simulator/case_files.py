"""Writes what the diagnosing process may see: a cell folder with nominal numbers and a recording folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from simulator.case_simulation import Case
from simulator.measurement_setup import MeasurementSetup
from simulator.sensor_readings import Table


def write_cell(source: Path, target: Path) -> None:
    """The cell as it was shipped: nominal stiffness, nominal geometry; no recordings, no notes."""
    shutil.copytree(
        source, target, dirs_exist_ok=True, ignore=shutil.ignore_patterns("recordings", "README.md", "stiffness_*")
    )


def write_recording(target: Path, case: Case, world: MeasurementSetup, table: Table) -> None:
    """recording.yaml and data.csv as the contract has them; the notes say what a technician would."""
    target.mkdir(parents=True, exist_ok=True)
    names = list(table.columns)
    cells = [_cells(name, table.columns[name]) for name in names]
    with (target / "data.csv").open("w", encoding="utf-8", newline="\n") as out:
        out.write(",".join(names) + "\n")
        out.writelines(",".join(row) + "\n" for row in zip(*cells, strict=True))
    lines = ["machopt_recording: 1", f"kind: {case.kind}", "data: data.csv"]
    if "fx_N" in names:
        lines.append(f"wrench_frame: {world.wrench_frame}")
    if case.kind == "deflection":
        lines.append("displacement_frame: base")
    fit = "x_mm" in names
    lines.append(f"registration: {'fit' if fit else 'fixed'}")
    stated = ["joint_deg: 0.0003"]
    if "dx_mm" in names or fit:
        stated.append("displacement_mm: 0.015")
    if "rx_mrad" in names or "qw" in names:
        stated.append("rotation_mrad: 0.03")
    if case.kind == "deflection":
        stated.append(f"force_N: {max(round(world.noise.force, 1), 0.1)}")
    lines.append("standard_uncertainty: {" + ", ".join(stated) + "}")
    notes = {
        "deflection": "dead weights over a pulley, laser tracker on a target at the tool",
        "absolute": "laser tracker, poses in random order",
        "motion": "excitation trajectories, several periods",
    }
    lines.append(f"notes: {notes[case.kind]}")
    (target / "recording.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _cells(name: str, values: object) -> list[str]:
    if name == "branch":
        return list(values)  # type: ignore[call-overload]
    array = np.asarray(values, float)
    if name in ("pose", "cycle", "session"):
        return [str(int(v)) for v in array]
    # shortest text; twelve digits cut the tail that a change of unit leaves
    return [f"{v:.12g}" for v in (array + 0.0).tolist()]
