"""Cache of results by the content of their inputs."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.collision.collision_model_cache import MODELS, load_collision_model
from machopt.data_types.cell import Cell
from machopt.kinematics.urdf_loading import load_chain
from machopt.numerics.content_cache import ContentCache, NoContentKeyError, build_content_key
from machopt.verification.motion.collision.cell_bodies import CellBodies, load_cell_bodies
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

CELL = Path(__file__).resolve().parents[1] / "cells" / "kr500_milling"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return shutil.copytree(CELL, tmp_path / "cell")


def bodies_of(cell: Cell) -> CellBodies:
    return load_cell_bodies(cell, UrdfKinematics(cell))


def scale_mesh(folder: Path, by: float) -> None:
    """Scale the tool's mesh in its binary STL file."""
    file = next(f for f in folder.rglob("tool.stl"))
    data = bytearray(file.read_bytes())
    facets = np.frombuffer(data, np.dtype([("numbers", "<f4", 12), ("colour", "<u2")]), offset=84)
    facets["numbers"][:, 3:] *= np.float32(by)
    file.write_bytes(data)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1, 1.5),
        (1, True),
        (0, None),
        ("a", b"a"),
        (np.zeros(2), np.zeros((2, 1))),
        (np.zeros(2), np.zeros(2, np.float32)),
        ((1, (2,)), ((1, 2),)),
        ({"a": 1}, {"a": 2}),
    ],
)
def test_different_content_has_a_different_key(one: object, other: object) -> None:
    assert build_content_key(one) != build_content_key(other)
    assert build_content_key(one) == build_content_key(one)


def test_value_without_content_is_refused() -> None:
    with pytest.raises(NoContentKeyError, match="object"):
        build_content_key(object())
    cache: ContentCache[int] = ContentCache()
    assert [cache.get((1, len), lambda k=k: k) for k in (5, 6)] == [5, 6]  # computed each time
    assert len(cache) == 0


def test_oldest_result_is_dropped_first_and_no_file_stores_none(tmp_path: Path) -> None:
    cache: ContentCache[int] = ContentCache(2)
    assert [cache.get(k, lambda k=k: k) for k in (1, 2, 1, 3)] == [1, 2, 1, 3]
    assert [cache.get(k, lambda: -1) for k in (1, 3, 2)] == [1, 3, -1]
    assert cache.get(tmp_path / "none", lambda: 7) == 7
    assert len(cache) == 2


def test_cell_of_the_same_content_has_the_same_bodies(folder: Path) -> None:
    """The bodies do not depend on the folder, program, stiffness or process of the cell."""
    given, copied = load_cell(CELL), load_cell(folder)
    assert bodies_of(given) is bodies_of(replace(copied, stiffness=None, process=None))


@pytest.mark.parametrize("change", ["mesh", "urdf", "tool", "limits"])
def test_changed_cell_has_new_bodies(folder: Path, change: str) -> None:
    cell = load_cell(folder)
    before, (robot, shapes) = bodies_of(cell), load_chain(cell)
    model = load_collision_model(cell, robot, shapes, 0.01)
    if change == "mesh":
        scale_mesh(folder, 1.5)
        cell = load_cell(folder)
    elif change == "urdf":
        cell.urdf.write_text(cell.urdf_text.replace("<mesh", "<mesh ", 1), encoding="utf-8")
    elif change == "tool":
        cell = replace(cell, tool=replace(cell.tool, T_flange_tcp=cell.tool.T_flange_tcp @ np.diag([1, -1, -1, 1.0])))
    else:
        cell = replace(cell, limits=replace(cell.limits, upper=cell.limits.upper - 0.1))
    assert bodies_of(cell) is not before
    other = load_collision_model(cell, *load_chain(cell), 0.01)
    assert other.outlines is not model.outlines
    first, second = (np.ptp(next(b for b in m.bodies if b.kind == "tool").vertices, axis=0) for m in (model, other))
    assert second == pytest.approx((1.5 if change == "mesh" else 1.0) * first)


def test_cached_model_measures_like_a_new_one(folder: Path) -> None:
    """Distances measured by one job bound later distances of the same model; they must not change the results of the
    next job."""
    cell = load_cell(folder)
    robot, shapes = load_chain(cell)
    q = cell.home + np.linspace(0.0, 1.0, 40)[:, None] * np.array([0.4, 0.5, -0.4, 0.8, 0.3, 1.0])
    cutting = np.zeros(len(q), bool)
    found = []
    for fresh in (True, False, False):
        if fresh:
            MODELS._values.clear()
        model = load_collision_model(cell, robot, shapes, 0.2)
        found.append(model.check_motion(q, cutting, 0.05))
    assert found[0].hit.any()
    for again in found[1:]:
        assert (again.hit == found[0].hit).all()
        assert (again.pair == found[0].pair).all()
        assert np.array_equal(again.row, found[0].row, equal_nan=True)


def test_pairs_equal_a_fresh_selection(folder: Path) -> None:
    cell = load_cell(folder)
    arm = UrdfKinematics(cell)
    retained, fresh = bodies_of(cell), CellBodies(load_cell_bodies(cell, arm).bodies)
    for clearance, touching in ((0.0, None), (0.01, None), (0.0, ()), (0.0, (("link2_0", "link0_0"),))):
        first = retained.list_checked_pairs(cell, arm, clearance, touching)
        assert retained.list_checked_pairs(cell, arm, clearance, touching) == first
        assert fresh.list_checked_pairs(cell, arm, clearance, touching) == first
        assert retained.list_varying_pairs(arm, first[0]) == fresh.list_varying_pairs(arm, first[0])


def test_meshes_come_from_the_current_package_folder(folder: Path) -> None:
    """Two copies of one package: after the first is deleted, no path refers to it."""
    urdf = next(folder.rglob("*.urdf"))
    urdf.write_text(urdf.read_text().replace('filename="meshes/link', 'filename="package://arm/meshes/link'))
    text = (folder / "cell.yaml").read_text()
    for name in ("first", "second"):
        shutil.copytree(folder / "meshes", folder / name / "meshes")
        (folder / "cell.yaml").write_text(f"{text}\npackages:\n  arm: {name}\n")
        cell = load_cell(folder)
        meshes = [s.shape.mesh for s in load_chain(cell)[1] if s.shape.mesh is not None]
        assert any(folder / name in mesh.parents for mesh in meshes)
        assert all(mesh.is_file() for mesh in meshes)
        shutil.rmtree(folder / name)
