"""Published real files (tests/vendored_files/SOURCES.md): read in every checkout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

CAM = Path(__file__).parent / "vendored_files" / "cam"


def test_every_file_states_its_source() -> None:
    """The total size of the files is small."""
    root = CAM.parent
    files = [f for f in root.rglob("*") if f.is_file() and f.name != "SOURCES.md"]
    sources = (root / "SOURCES.md").read_text(encoding="utf-8")
    for f in files:
        part = f.relative_to(root).as_posix()
        named = (part, "/".join(part.split("/")[:2]) + "/", part.split("__")[0] + "__*")
        assert any(f"`{name}" in sources for name in named), part
    assert sum(f.stat().st_size for f in files) < 300_000


def test_table_of_poses_without_a_header() -> None:
    """Row by row as in the file: x, y, z in mm; the angles are rotations about fixed axes."""
    file = CAM / "RoboDK__Example-Import-CSV-XYZWPR.csv"
    values = np.loadtxt(file, delimiter=",")
    t = read_toolpath(file, default_feed=0.01)
    assert len(t) == len(values) == 201
    np.testing.assert_allclose(t.position * 1e3, values[:, :3], atol=1e-9)
    w, p, r = np.radians(values[:, 3:6]).T
    z = np.stack([np.cos(w) * np.sin(p) * np.cos(r) + np.sin(w) * np.sin(r),
                  np.cos(w) * np.sin(p) * np.sin(r) - np.sin(w) * np.cos(r),
                  np.cos(w) * np.cos(p)], axis=1)  # third column of Rz(r) Ry(p) Rx(w)  # fmt: skip
    np.testing.assert_allclose(np.abs(np.einsum("ni,ni->n", t.axis, z)), 1.0, atol=1e-9)


def test_four_quarter_arcs_are_a_circle_of_half_an_inch() -> None:
    t = read_toolpath(CAM / "cncjs__circle-inch.gcode")
    round_ = t.cutting & (np.abs(t.position[:, 2]) < 1e-12)
    radius = np.linalg.norm(t.position[round_, :2], axis=1)
    assert radius.max() == pytest.approx(0.0127, abs=1e-9)
    assert (radius > 0.0127 - 20e-6).all()  # tolerance: chords of arcs
    angle = np.unwrap(np.arctan2(t.position[round_, 1], t.position[round_, 0]))
    assert np.ptp(angle) == pytest.approx(2 * np.pi, abs=1e-6)
    assert (np.diff(angle) <= 1e-12).all()  # G2 is clockwise


def test_ambiguous_move_after_a_circle_leads_to_a_question() -> None:
    """After a full circle (I alone) the file moves back with X alone; it states no unit,
    but no unit corrects this error."""
    file = CAM / "cncjs__full-circle-without-xyz.gcode"
    with pytest.raises(InputError, match="line 11: an arc without I, J, K or R"):
        read_toolpath(file)
    with pytest.raises(InputError, match="line 11: an arc without I, J, K or R"):
        read_toolpath(file, unit="inch", default_feed=0.01)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "ros-industrial__kuka_eki_hw_interface.src",
            "line 67: JOINT_POS_TGT gets its value only while",
        ),
        ("ros-industrial__i_hw_interface_krl_KR_C4__ros_rsi.src", "2 joint moves and no linear one"),
    ],
)
def test_programs_without_a_path_are_reported(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_toolpath(CAM / name, default_feed=0.01)
