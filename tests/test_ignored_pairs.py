"""Pairs of bodies that may touch: ``ignore_pairs`` and SRDF, in planner and verification."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cell import small_cell

from machopt.cell.ignored_pairs import IgnoredPairReader
from machopt.cell.urdf import read_urdf
from machopt.cell.urdf.srdf_reader import read_srdf
from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import Cell, CollisionShape, IgnoredPair
from machopt.data_types.plan_options import PlanOptions
from machopt.errors import InputError
from machopt.file_formats.strict_yaml import KeyPath, parse_yaml
from machopt.kinematics.urdf_loading import load_chain
from machopt.verification.folder.verification_scope import list_unchecked
from machopt.verification.motion.collision.bodies import build_bodies, compute_distance
from machopt.verification.motion.collision.checked_pairs import list_checked_pairs
from machopt.verification.motion.collision.urdf_inventory import check_inventory
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

SRDF = """<robot name="small">
  <disable_collisions link1="base_link" link2="link_1" reason="Adjacent"/>
  <disable_collisions link1="base_link" link2="link_2" reason="Never"/>
  <disable_collisions link1="gripper" link2="link_2"/>
  <group name="arm"/>
</robot>"""


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return small_cell(tmp_path_factory.mktemp("touch"))


def read_ignored_pairs(cell: Cell, *entries: str | list[str]) -> tuple[IgnoredPair, ...]:
    document = parse_yaml("ignore_pairs: []", "cell.yaml")
    reader = IgnoredPairReader(read_urdf(cell.urdf), "flange", cell.tool, cell.workpiece, cell.obstacles, document)

    def open_file(loc: KeyPath, name: str) -> Path:
        return cell.folder / name

    return reader.pairs(list(entries), open_file)


def test_names_refer_to_their_bodies(cell: Cell) -> None:
    (cell.folder / "robot.srdf").write_text(SRDF)
    tool = cell.tool.geometry[0].name
    found = read_ignored_pairs(cell, ["link_1", "link_3_0"], ["tool", cell.obstacles[0].name], "robot.srdf")
    assert [(m.first, m.second) for m in found] == [
        (("link_1_0",), ("link_3_0",)),
        ((tool,), (cell.obstacles[0].name,)),
        (("base_link_0",), ("link_2_0",)),  # adjacent links, and links of another robot, are not included
    ]
    assert found[2].source == "robot.srdf line 3: Never"


@pytest.mark.parametrize(
    ("entry", "parts"),
    [
        (["link_1", "lnk_3"], ["ignore_pairs[0][1]", "'lnk_3' is no link", "did you mean 'link_3'?", "workpiece"]),
        (["flange", "tool"], ["share a body"]),
        (["tool", "tool"], ["share a body"]),
    ],
)
def test_invalid_pairs_are_refused(cell: Cell, entry: list[str], parts: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        read_ignored_pairs(cell, entry)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize(("name", "like"), [("base_link_0", "link base_link"), ("cutter", "the tool's cutter")])
def test_ambiguous_body_name_is_refused(cell: Cell, name: str, like: str) -> None:
    """Planner and verification identify pairs by name, so the permission would also apply to the other body."""
    assert cell.tool.cutter is not None
    twice = replace(cell, obstacles=(replace(cell.obstacles[0], name=name),))
    assert read_ignored_pairs(twice) == ()  # without ignored pairs a repeated name has no effect
    with pytest.raises(InputError, match=f"named '{name}' like .*{like}; another name would work"):
        read_ignored_pairs(twice, ["link_1", "link_3"])


def test_flange_and_world_include_the_bodies_attached_to_them(cell: Cell) -> None:
    (pair,) = read_ignored_pairs(cell, ["world", "flange"])
    assert pair.first == tuple(s.name for s in (*cell.obstacles, *cell.workpiece.geometry))
    assert pair.second == tuple(s.name for s in cell.tool.geometry)


def test_srdf_defaults_and_exceptions(cell: Cell, tmp_path: Path) -> None:
    path = tmp_path / "a.srdf"
    path.write_text('<robot><disable_default_collisions link="a"/><enable_collisions link1="c" link2="a"/></robot>')
    assert [(p.link1, p.link2, p.reason) for p in read_srdf(path, ("a", "b", "c"))] == [("a", "b", "Default")]
    path.write_text('<robot>\n<disable_collisions link1="a"/></robot>')
    with pytest.raises(InputError, match="line 2: <disable_collisions> has no 'link2'"):
        read_srdf(path, ("a",))
    path.write_text('<robot xmlns:xacro="x"><xacro:include filename="b"/></robot>')
    with pytest.raises(InputError, match="the SRDF that it expands to"):
        read_ignored_pairs(cell, path.as_posix())
    path.write_text("<urdf/>")
    with pytest.raises(InputError, match="an SRDF starts with <robot>"):
        read_srdf(path, ("a",))


def test_pairs_with_a_constant_distance_are_excluded_by_planner_and_verifier(cell: Cell) -> None:
    """A disc about axis 6 has the same distance to link 5 in every pose.

    Where this distance was below the clearance, correct plans failed.
    """
    disc = CollisionShape(name="disc", kind="cylinder", size=(0.02, 0.004), mesh=None, T_parent_shape=np.eye(4))
    round_tool = replace(cell, tool=replace(cell.tool, geometry=(disc,)))
    arm = UrdfKinematics(round_tool)
    bodies = build_bodies(round_tool, arm)
    link, plate = (next(b for b in bodies if b.name == name) for name in ("link_5_0", "disc"))
    far = []
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (3, 6)):
        T = arm.compute_placements(q[None], np.zeros((1, 0)))[0]
        far.append(compute_distance(link, plate, np.linalg.inv(T[link.carrier]) @ T[plate.carrier]))
    assert far[0] > 1e-3
    assert np.ptp(far) < 1e-6
    robot, shapes = load_chain(round_tool)
    for clearance, retained in ((far[0] - 5e-4, True), (far[0] + 5e-4, False)):
        model = CollisionModel(round_tool, robot, shapes, clearance)
        assert ("link_5_0 ~ disc" in {p.name for p in model.pairs}) is retained
        named = {f"{a.name} ~ {b.name}" for a, b in list_checked_pairs(round_tool, arm, bodies, clearance)}
        assert ("link_5_0 ~ disc" in named) is retained


def test_planner_and_verification_exclude_and_report_the_same_pairs(cell: Cell) -> None:
    lenient = replace(
        cell, may_touch=read_ignored_pairs(cell, ["base_link", "link_2"], ["cutter", cell.obstacles[0].name])
    )
    names = {"base_link_0 ~ link_2_0", f"{cell.obstacles[0].name} ~ cutter"}
    found = []
    for each in (cell, lenient):
        robot, shapes = load_chain(each)
        model = CollisionModel(each, robot, shapes, 0.0)
        arm = UrdfKinematics(each)
        found.append(
            (
                {p.name for p in model.pairs},
                {f"{a.name} ~ {b.name}" for a, b in list_checked_pairs(each, arm, build_bodies(each, arm))},
            )
        )
    assert found[0][0] - found[1][0] == names
    assert found[0][1] - found[1][1] == names
    assert {f"{e.a} ~ {e.b}" for e in model.excluded} == names
    assert all("ignore_pairs of cell.yaml" in e.reason for e in model.excluded)
    assert ("link_1_0", "link_2_0") in {(e.a, e.b) for e in model.adjacent}
    assert any(
        "base_link ~ link_2" in words and "ignore_pairs" in words for words in list_unchecked(lenient, PlanOptions())
    )


def test_contact_at_home_names_the_key_that_allows_it(cell: Cell) -> None:
    robot, shapes = load_chain(cell)
    T = np.linalg.inv(robot.compute_fk(cell.home)) @ np.array(
        [[1, 0, 0, 0.4], [0, 1, 0, 0], [0, 0, 1, 1.2], [0, 0, 0, 1.0]]
    )
    boom = CollisionShape(
        name="boom", kind="sphere", size=(0.2,), mesh=None, T_parent_shape=T
    )  # in link 2 at home, but not in most other poses
    home = replace(cell, tool=replace(cell.tool, geometry=(boom,)))
    model = CollisionModel(home, robot, shapes, 0.0)
    assert any("`ignore_pairs: [[link_2_0, boom]]` in cell.yaml" in words for words in model.suspicious)


def test_srdf_of_another_robot_is_reported(cell: Cell) -> None:
    (cell.folder / "other.srdf").write_text(
        '<robot name="o"><disable_collisions link1="Link_1" link2="Link_3"/></robot>'
    )
    document = parse_yaml("ignore_pairs: []", "cell.yaml")
    reader = IgnoredPairReader(read_urdf(cell.urdf), "flange", cell.tool, cell.workpiece, cell.obstacles, document)
    assert reader.pairs(["other.srdf"], lambda loc, name: cell.folder / name) == ()
    (warning,) = reader.warnings
    assert "other.srdf names no two links of this robot in any of its 1 pairs (its first is Link_1 ~ Link_3)" in warning


def test_body_without_pairs_is_accepted_only_where_the_cell_allows_it(cell: Cell) -> None:
    arm = UrdfKinematics(cell)
    bodies = build_bodies(cell, arm)
    every = list_checked_pairs(cell, arm, bodies)

    def told(others: tuple[str, ...]) -> list[str]:
        """Check an inventory without any pair of link 3, which the cell allows to touch some other bodies."""
        lenient = replace(cell, may_touch=(IgnoredPair("a", "b", ("link_3_0",), others, "here"),))
        left = [pair for pair in list_checked_pairs(lenient, arm, bodies) if "link_3_0" not in {b.name for b in pair}]
        return [c.where for c in check_inventory(lenient, arm, bodies, left) if c.passed is False]

    rivals = {b.name for pair in every if "link_3_0" in {x.name for x in pair} for b in pair} - {"link_3_0"}
    (where,) = told(("base_link_0",))
    assert "link 'link_3_0' is in no pair that is checked" in where
    lenient = replace(cell, may_touch=(IgnoredPair("a", "b", ("link_3_0",), tuple(sorted(rivals)), "here"),))
    left = list_checked_pairs(lenient, arm, bodies)
    assert all(c.passed for c in check_inventory(lenient, arm, bodies, left))


def test_body_that_nothing_moves_against_is_in_no_pair(cell: Cell, tmp_path: Path) -> None:
    """An arm without collision bodies in an empty cell, as `machopt init` writes it for such a URDF."""
    bare = tmp_path / "bare.urdf"
    bare.write_text(re.sub(r"<collision>.*?</collision>", "", cell.urdf.read_text(), flags=re.DOTALL))
    alone = replace(cell, urdf=bare, obstacles=(), workpiece=replace(cell.workpiece, geometry=()))

    def told(cell: Cell, *, all_pairs: bool) -> list[str]:
        arm = UrdfKinematics(cell)
        bodies = build_bodies(cell, arm)
        wanted = list_checked_pairs(cell, arm, bodies) if all_pairs else []
        return [c.where for c in check_inventory(cell, arm, bodies, wanted) if c.passed is False]

    assert told(alone, all_pairs=True) == []
    additional = replace(alone, obstacles=cell.obstacles)
    assert told(additional, all_pairs=True) == []
    (where,) = told(additional, all_pairs=False)
    assert "is in no pair that is checked" in where
