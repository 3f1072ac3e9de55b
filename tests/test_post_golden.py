"""Golden programs, compared byte by byte; ``python tests/golden/make_golden.py`` rewrites them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

GOLDEN = Path(__file__).resolve().parent / "golden"
sys.path.insert(0, str(GOLDEN))

from make_golden import job, write  # noqa: E402
from sample_robot_programs import ARM, TOOL, WORKPIECE  # noqa: E402

from machopt.data_types.robot_program import LIN  # noqa: E402
from machopt.programs.program_reader import read_program  # noqa: E402
from machopt.programs.program_writer import list_post_names  # noqa: E402


def relative(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


@pytest.mark.parametrize("post", list_post_names())
def test_program_equals_the_golden_one(tmp_path: Path, post: str) -> None:
    write(tmp_path, post)
    assert relative(tmp_path) == relative(GOLDEN / post)
    for name in relative(tmp_path):
        assert (tmp_path / name).read_bytes() == (GOLDEN / post / name).read_bytes(), (
            f"{post}/{name} differs: look at it, then run python tests/golden/make_golden.py"
        )


def test_no_unused_golden_files() -> None:
    assert {p.name for p in GOLDEN.iterdir() if p.is_dir() and not p.name.startswith("__")} == set(list_post_names())


def test_golden_job_agrees_with_its_joints() -> None:
    p = job()
    T = np.linalg.inv(WORKPIECE) @ ARM.compute_fk(p.q, TOOL)
    np.testing.assert_allclose(p.T_workpiece_tcp, T, atol=1e-12)
    golden = read_program(GOLDEN / "rapid" / "golden.mod")
    lin = p.kind == LIN
    np.testing.assert_allclose(golden.T_base_tcp[lin][:, :3, 3], T[lin][:, :3, 3], atol=0.51e-7)
    assert [e.text for e in golden.events] == [e.text for e in p.events]
