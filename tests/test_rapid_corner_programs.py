"""Blended corners between joint moves in the programs of every maker, written and read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sample_robot_programs import ARM, PLAIN, TOOL, WORKPIECE, Recipe, program

from machopt.data_types.robot_program import LIN, PTP, RobotProgram
from machopt.data_types.toolpath import MoveKind, ToolpathEvent
from machopt.programs.maker_registry import load_checks
from machopt.programs.program_reader import read_program
from machopt.programs.program_writer import write_program
from machopt.programs.writing.blend_zones import compute_blend_zones

SHARE, ZONE = 0.4375, 0.0123  # of a move, m
PRINTED = 0.01  # m, the largest preferred number below the zone
JOINTS = 4  # joint moves, followed by a line; moves 1 and 2 are blended


def build_rounded_program(*events: ToolpathEvent) -> RobotProgram:
    """Four joint moves and two lines; the second and the third joint move end at blended corners."""
    made = program(Recipe(3, moves=6, events=0))
    kind = np.array([PTP] * JOINTS + [LIN] * 2, np.int8)
    q = made.q[0] + np.cumsum(np.full((6, 6), 0.02), axis=0)
    share = np.array([0.0, SHARE, SHARE, SHARE, 0.0, 0.0])
    return replace(
        made,
        kind=kind,
        q=q,
        T_workpiece_tcp=np.linalg.inv(WORKPIECE) @ ARM.compute_fk(q, TOOL),
        feed=np.where(kind == LIN, 0.05, np.nan),
        cutting=kind == LIN,
        move=np.where(kind == LIN, MoveKind.CUT, MoveKind.RAPID).astype(np.int8),
        events=events,
        rapid_share=share,
        rapid_zone=np.where(share > 0.0, ZONE, 0.0),
    )


DISTANCES = ["rapid", "urscript", "urscript_movep", "val3", "csv", "json"]


@pytest.mark.parametrize("post", DISTANCES)
def test_blend_zone_is_the_largest_preferred_number_below_the_limit(post: str, tmp_path: Path) -> None:
    """The last joint move precedes a line: it stops."""
    files = write_program(tmp_path, "part", build_rounded_program(), post, PLAIN)
    np.testing.assert_allclose(read_program(files[0]).blend[:4], [0.0, PRINTED, PRINTED, 0.0], atol=1e-6)


@pytest.mark.parametrize("post", ["krl", "krl_spline"])
def test_kuka_uses_the_share_directly(post: str, tmp_path: Path) -> None:
    files = write_program(tmp_path, "part", build_rounded_program(), post, PLAIN)
    parsed = read_program(files[0])
    list_shares = load_checks(parsed.dialect).list_rounded_shares
    assert list_shares is not None
    shares = np.array(list_shares(parsed.configuration))
    np.testing.assert_array_equal(np.isfinite(shares), [False, True, True, False, False, False])
    assert (shares[1:3] <= SHARE).all()
    assert (shares[1:3] > SHARE - 0.005).all()  # whole percent of half a move
    assert "C_PTP" in files[0].read_text(encoding="ascii")


@pytest.mark.parametrize("post", ["fanuc", "fanuc_joint", "jbi"])
def test_robot_stops_where_no_distance_bounds_the_blend(post: str, tmp_path: Path) -> None:
    """CNT defines no distance; without position_levels_mm PL does not either."""
    rounding, straight = build_rounded_program(), replace(build_rounded_program(), rapid_share=None, rapid_zone=None)
    texts = []
    for n, one in enumerate((rounding, straight)):
        folder = tmp_path / str(n)
        folder.mkdir()
        files = write_program(folder, "PART", one, post, PLAIN)
        texts.append(
            [line for line in files[0].read_text(encoding="ascii").splitlines() if "FINE" in line or "MOVJ" in line]
        )
        assert not any(w.get("pl") for w in read_program(files[0]).configuration[:JOINTS])
    moves = [[line.split(":", 1)[-1] for line in lines] for lines in texts]
    assert moves[0] == moves[1]


def test_yaskawa_uses_the_largest_level_inside_the_zone(tmp_path: Path) -> None:
    levels = np.array([0.001, 0.005, 0.012, 0.05, 0.1, 0.2, 0.3, 0.4])
    files = write_program(tmp_path, "PART", build_rounded_program(), "jbi", replace(PLAIN, position_levels=levels))
    found = [w.get("pl") for w in read_program(files[0]).configuration[:JOINTS]]
    assert found == [0, 3, 3, 0]


def test_robot_stops_before_an_event_and_at_the_end_of_a_section() -> None:
    zones = compute_blend_zones(build_rounded_program(ToolpathEvent(2, "coolant", "M8"))).distance
    np.testing.assert_allclose(zones[:4], [0.0, 0.0, PRINTED, 0.0])
    np.testing.assert_allclose(compute_blend_zones(build_rounded_program(), 2).distance[:4], [0.0, 0.0, PRINTED, 0.0])


ZONED = ["rapid", "urscript", "urscript_movep", "val3", "krl", "krl_pos", "krl_spline", "fanuc", "fanuc_joint", "jbi"]


@pytest.mark.parametrize("post", [*ZONED, "jbi_rectan"])
def test_stopping_joint_move_states_an_exact_stop(post: str, tmp_path: Path) -> None:
    """When the program is read back, no joint move has a zone that is left to the controller."""
    files = write_program(
        tmp_path, "PART", replace(build_rounded_program(), rapid_share=None, rapid_zone=None), post, PLAIN
    )
    np.testing.assert_array_equal(read_program(files[0]).blend[:JOINTS], 0.0)


@pytest.mark.parametrize("post", [*ZONED, "jbi_rectan"])
def test_last_joint_move_before_a_line_stops(post: str, tmp_path: Path) -> None:
    files = write_program(tmp_path, "PART", build_rounded_program(), post, PLAIN)
    assert read_program(files[0]).blend[[0, JOINTS - 1]].tolist() == [0.0, 0.0]
