"""Binary STL, boxes and cylinders compared with trimesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from machopt.collision.bodies import is_closed_surface, triangulate_shape
from machopt.data_types.cell import CollisionShape
from machopt.numerics import mesh_construction
from machopt.numerics.mesh_construction import (
    TriangleMesh,
    build_box,
    build_cylinder,
    merge_equal_vertices,
    parse_binary_stl,
)


def is_equal(ours: TriangleMesh | None, theirs: trimesh.Trimesh) -> bool:
    return (
        ours is not None
        and np.array_equal(ours.vertices, theirs.vertices)
        and np.array_equal(ours.faces, theirs.faces)
        and ours.faces.dtype == np.int64
    )


@pytest.mark.parametrize(
    "solid",
    [
        trimesh.creation.icosphere(subdivisions=2, radius=0.21),
        trimesh.creation.annulus(r_min=30.0, r_max=80.0, height=50.0, sections=17),  # in mm
    ],
)
def test_binary_stl_is_read_as_by_trimesh(solid: trimesh.Trimesh, tmp_path: Path) -> None:
    file = tmp_path / "solid.stl"
    solid.export(file)
    raw = parse_binary_stl(file.read_bytes())
    assert raw is not None
    assert is_equal(raw, trimesh.load_mesh(file, process=False))
    assert is_equal(merge_equal_vertices(raw), trimesh.load(file, force="mesh"))
    assert parse_binary_stl(file.read_bytes()[:-1]) is None
    assert parse_binary_stl(solid.export(file_type="stl_ascii").encode()) is None


def test_nonfinite_corners_are_left_out_with_their_triangles(tmp_path: Path) -> None:
    solid = trimesh.creation.box((1.0, 2.0, 3.0))
    raw = merge_equal_vertices(TriangleMesh(np.array(solid.vertices), np.array(solid.faces)))
    vertices = np.vstack([raw.vertices, raw.vertices[:2], [[np.nan] * 3]])  # two corners twice, one invalid
    faces = np.vstack([raw.faces, [[8, 9, 10], [8, 9, 3]]])
    found = merge_equal_vertices(TriangleMesh(vertices, faces))
    retained = [
        *raw.vertices[raw.faces].tolist(),
        raw.vertices[[0, 1, 3]].tolist(),
    ]  # versions of trimesh differ in this
    assert sorted(found.vertices[found.faces].tolist()) == sorted(retained)
    assert len(found.faces) == len(raw.faces) + 1


def test_boxes_and_cylinders_equal_trimesh() -> None:
    assert is_equal(build_box((0.4, 0.3, 0.05)), trimesh.creation.box((0.4, 0.3, 0.05)))
    for radius, height in ((0.005, 0.04), (0.3, 1.7)):
        assert is_equal(
            build_cylinder(radius, height, 48), trimesh.creation.cylinder(radius=radius, height=height, sections=48)
        )


def test_thin_cutter_keeps_its_end_faces() -> None:
    """trimesh omits triangles below 1e-8 m²: those of a cutter of 0.5 mm."""
    assert is_closed_surface(build_cylinder(0.25e-3, 5e-3, 48).faces)


def test_body_with_hard_edges_is_closed(tmp_path: Path) -> None:
    """In an OBJ, its corners occur once for every normal."""
    solid = trimesh.creation.box((0.1, 0.2, 0.3))
    solid.unmerge_vertices()
    lines = [f"v {' '.join(map(str, v))}" for v in solid.vertices.tolist()]
    lines += [f"vn {' '.join(map(str, v))}" for v in np.repeat(solid.face_normals, 3, axis=0).tolist()]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (solid.faces + 1).tolist()]
    file = tmp_path / "hard.obj"
    file.write_text("\n".join(lines) + "\n")
    vertices, faces = triangulate_shape(
        CollisionShape(name="hard", kind="mesh", size=(1.0,), mesh=file, T_parent_shape=np.eye(4))
    )
    assert len(vertices) == 8
    assert is_closed_surface(faces)


def test_corners_with_equal_hash_are_distinguished(monkeypatch: pytest.MonkeyPatch) -> None:
    solid = trimesh.creation.icosphere(subdivisions=1)
    apart = TriangleMesh(solid.vertices[solid.faces].reshape(-1, 3), np.arange(3 * len(solid.faces)).reshape(-1, 3))
    whole = merge_equal_vertices(apart)
    assert len(whole.vertices) == len(solid.vertices)
    monkeypatch.setattr(mesh_construction, "MIXED", np.array([2, 0, 0]))  # corners with the same x have the same hash
    assert all(np.array_equal(a, b) for a, b in zip(merge_equal_vertices(apart), whole, strict=True))


def test_merging_nothing_gives_nothing() -> None:
    none = merge_equal_vertices(TriangleMesh(np.full((3, 3), np.nan), np.array([[0, 1, 2]])))
    assert none.vertices.shape == (0, 3)
    assert none.faces.shape == (0, 3)
