"""Writer of a cell copy with moved workpiece, obstacles or robot: same files, other poses in cell.yaml."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from machopt.data_types.cell import Cell
from machopt.errors import CellError
from machopt.file_formats.file_reading import YAML as MOST
from machopt.file_formats.file_reading import read_text
from machopt.numerics.array_types import Array

OTHER_PROCESS = "process_in_force.yaml"  # in the copy, of a process.yaml from outside the cell folder
PROCESS_MARK, HEAD_BYTES = b"machopt_process", 4096  # by which such a file is known, and where it is looked for
SAME = 1e-12  # of a pose, m or a matrix's entries: not written anew


def write_moved_cell(folder: Path, before: Cell, after: Cell, head: str) -> Path:
    """Write the cell ``after`` into a new folder; comments and everything that is not a pose stay as they are.

    A process.yaml that replaces that of the cell is copied, too, and cell.yaml names it.

    Args:
        folder: made; the files of ``before`` are copied into it under the names they have in their cell.
        before: as it was loaded.
        after: the same with other poses of base, workpiece and obstacles.
        head: one line of comment above the rest.

    Returns:
        The new cell.yaml.

    Raises:
        InputError: the cell uses files outside its folder.
    """
    names = {f: str(f.relative_to(before.folder)) for f in before.files if f.is_relative_to(before.folder)}
    process = next((f for f in before.files if _is_process_file(f)), None)
    if process is not None:
        names.setdefault(process, OTHER_PROCESS)
    outside = [f for f in before.files if f not in names]
    if outside:
        raise CellError(
            f"the cell uses {outside[0]}, which lies outside its folder and so in no copy of it; the file in the cell "
            "folder would work",
            file=before.folder / "cell.yaml",
        )
    for file in before.files:
        target = folder / names[file]
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, target)
    target = folder / "cell.yaml"
    text = read_text(before.folder / "cell.yaml", expected="a cell", most=MOST)
    text = _replace_poses(text, before, after, None if process is None else names[process])
    target.write_text(f"# {head}\n{text}", encoding="utf-8", newline="\n")
    return target


def _is_process_file(file: Path) -> bool:
    if file.suffix.lower() not in (".yaml", ".yml"):
        return False
    with file.open("rb") as data:
        return PROCESS_MARK in data.read(HEAD_BYTES)


def _replace_poses(text: str, before: Cell, after: Cell, process: str | None) -> str:
    """Return cell.yaml with other poses, and with the process.yaml that was in force where it names another."""
    import io

    from ruamel.yaml import YAML

    yaml = YAML()  # keeps comments, order and the way numbers are written
    yaml.width = 4096
    document = yaml.load(text)
    if not _is_same_pose(before.T_world_base, after.T_world_base):
        document["robot"]["pose"] = _format_pose(after.T_world_base)
    if not _is_same_pose(before.workpiece.T_link_workpiece, after.workpiece.T_link_workpiece):
        document["workpiece"]["pose"] = _format_pose(after.workpiece.T_link_workpiece)
    written = document.get("obstacles") or []
    own = len(written)  # behind them the fixtures of offsets, whose poses are in frames that move with the workpiece
    for keys, old, new in zip(written, before.obstacles[:own], after.obstacles[:own], strict=True):
        if not _is_same_pose(old.T_parent_shape, new.T_parent_shape):
            keys.update(_format_pose(new.T_parent_shape))
    if process is not None and document.get("process") != process:
        document["process"] = process
    out = io.StringIO()
    yaml.dump(document, out)
    return out.getvalue()


def _is_same_pose(a: Array, b: Array) -> bool:
    return bool(np.abs(a - b).max() <= SAME)


def _format_pose(T: Array) -> dict[str, Any]:
    """xyz_mm and rpy_deg to a nanometre and a nanodegree, in flow style as people write them."""
    from ruamel.yaml.comments import CommentedMap, CommentedSeq
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
    out = CommentedMap()
    for name, values in (("xyz_mm", 1e3 * T[:3, 3]), ("rpy_deg", angles)):
        row = CommentedSeq([round(float(v), 6) + 0.0 for v in values])
        row.fa.set_flow_style()
        out[name] = row
    out.fa.set_flow_style()
    return out
