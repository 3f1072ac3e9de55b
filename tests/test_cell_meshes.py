"""Damaged mesh files: truncated, empty, flat, wrong unit, huge, unsupported type."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from minimal_cell_files import read_refusal_message, replace_in_file, write_minimal_cell

from machopt.cell.cell_reader import load_cell
from machopt.cell.mesh import read_surface
from machopt.errors import InputError

BOX = trimesh.creation.box((0.1, 0.2, 0.3))
FACET = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_minimal_cell(tmp_path / "cell")


def export_mesh(kind: str, mesh: trimesh.Trimesh = BOX, **options: str) -> bytes:
    data = mesh.export(file_type=kind, **options)
    return data.encode() if isinstance(data, str) else data


def build_stl(*triangles: list[list[float]]) -> bytes:
    corners = np.array(triangles, dtype="<f4")
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *t.ravel(), 0) for t in corners)
    return bytes(80) + struct.pack("<I", len(corners)) + body


STL, ASCII, PLY = export_mesh("stl"), export_mesh("stl_ascii"), export_mesh("ply")
ASCII_PLY, OFF, OBJ = export_mesh("ply", encoding="ascii"), export_mesh("off"), export_mesh("obj")
SHEET = build_stl(*[[[0, 0, 0], [1, n, 0], [0, n + 1, 0]] for n in range(6)])  # type: ignore[list-item]
FOLDED = export_mesh(
    "stl",
    trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [2, 1, 0], [0, 1, 3], [3, 1, 0]], process=False
    ),
)
DAMAGES = [  # suffix, content, words of the refusal
    ("stl", b"", ["is empty"]),
    ("stl", STL[:-1], ["is cut", "counts 12 triangles, which take 684 bytes, and it holds 683"]),
    ("stl", STL[:100], ["is cut", "12 triangles"]),
    ("stl", STL[:60], ["60 bytes are too few for binary STL"]),
    ("stl", STL + b"\0", ["is damaged", "684 bytes, and it holds 685"]),
    ("stl", STL[:80] + struct.pack("<I", 3_000_000) + STL[84:], ["is cut", "3000000 triangles"]),
    ("stl", bytes(84), ["holds no triangles"]),
    ("stl", ASCII[: len(ASCII) // 2], ["is cut or damaged", "is the last"]),
    ("stl", ASCII[: ASCII.rindex(b"endsolid")], ["is cut or damaged: 12 facets begin, 12 end"]),
    ("stl", ASCII.replace(b"vertex", b"vertx", 1), ["35 corners of 36"]),
    ("stl", ASCII.replace(b"0.05", b"0,05", 1), ["is damaged in its line", "0,05"]),
    ("stl", ASCII.replace(b"0.05", b"nan", 1), ["is damaged in its line", "nan"]),
    ("stl", ASCII.replace(b"0.05", b"1e3", 1), ["m wide"]),
    ("stl", STL[:96] + struct.pack("<f", float("nan")) + STL[100:], ["not finite"]),
    ("stl", STL[:96] + struct.pack("<f", float("inf")) + STL[100:], ["not finite"]),
    ("ply", ASCII_PLY.replace(b"\n3 1 3 0", b"\n3 1 3 -1"), ["found the face b'3 1 3 -1' of 8 vertices"]),
    ("stl", f"solid x\n{FACET}endsolid x\n".encode(), ["holds 1 triangle, which enclose nothing"]),
    ("stl", f"solid x\n{FACET * 8}endsolid x\n".encode(), ["is flat and encloses nothing"]),
    ("stl", SHEET, ["is flat"]),
    ("stl", FOLDED, ["has no volume"]),
    ("stl", build_stl(*[[[1, 1, 1]] * 3] * 8), ["is flat"]),
    ("ply", PLY[:-30], ["is cut or damaged"]),
    ("ply", PLY[:30], ["does not begin with a PLY header"]),
    ("ply", ASCII_PLY[:-30], ["is cut", "its header counts 8 vertices and 12 faces"]),
    ("ply", ASCII_PLY.replace(b"element face 12", b"element face 0"), ["holds no triangles"]),
    ("ply", ASCII_PLY.replace(b"vertex 8", b"vertex 99999999999"), ["is cut", "99999999999 vertices"]),
    ("off", OFF[:-20], ["is cut", "8 vertices and 12 faces"]),
    ("off", b"8 12 0\n", ["does not begin with OFF"]),
    # otherwise aborts the process in coal
    ("ply", ASCII_PLY.replace(b"\n3 1 3 0", b"\n3 1 3 0.5"), ["found the face"]),
    ("ply", ASCII_PLY.replace(b"list uchar int", b"list float int"), ["is damaged in its line"]),
    ("ply", PLY.replace(b"\x03\x01\0\0\0", b"\x0b\x01\0\0\0", 1), ["not all triangles"]),
    ("off", OFF.replace(b"\n3 1 3 0", b"\n3 1 3 8"), ["found the face"]),
    ("obj", b"hello\n", ["holds no triangles"]),
    ("obj", OBJ.replace(b"\nf ", b"\nf x", 1), ["is damaged in its line"]),
    ("obj", OBJ.replace(b"\nv ", b"\nv 1,0 ", 1), ["is damaged in its line", "1,0"]),
    ("obj", OBJ + b"\nf 1 2 99\n", ["cannot be read"]),
    ("obj", STL, ["is binary, and OBJ is text"]),
    ("dae", b"<COLLADA/>", ["broken.dae", "scene"]),
    ("step", b"ISO-10303-21;", ["is of type '.step'"]),
    ("", STL, ["is of type 'none'"]),
]


@pytest.mark.parametrize(("suffix", "data", "parts"), DAMAGES, ids=[f"{n} {d[0]}" for n, d in enumerate(DAMAGES)])
def test_damaged_mesh_of_the_tool_is_refused(folder: Path, suffix: str, data: bytes, parts: list[str]) -> None:
    name = f"broken.{suffix}" if suffix else "broken"
    (folder / name).write_bytes(data)
    line = replace_in_file(folder, "mesh: spindle.stl", f"mesh: {name}")
    read_refusal_message(folder, f"cell.yaml: line {line}: tool.geometry[0].mesh: mesh {name}", *parts)


def test_damaged_mesh_of_a_link_is_refused_at_its_line(folder: Path) -> None:
    (folder / "link.stl").write_bytes(STL[:-1])
    read_refusal_message(folder, "robot.urdf: line 47: collision mesh of link 'l6': mesh link.stl is cut")


def test_every_mesh_type_gives_planner_and_verifier_the_same_body(folder: Path) -> None:
    import coal

    for name, data in {
        "a.stl": STL,
        "b.stl": ASCII,
        "c.ply": PLY,
        "d.ply": ASCII_PLY,
        "e.off": OFF,
        "f.obj": OBJ,
    }.items():
        (folder / name).write_bytes(data)
        old = (folder / "cell.yaml").read_text()
        replace_in_file(folder, "mesh: spindle.stl", f"mesh: {name}")
        assert load_cell(folder).warnings == ()
        (folder / "cell.yaml").write_text(old)
        observed = coal.MeshLoader().load(str(folder / name), np.ones(3))
        observed.computeLocalAABB()
        np.testing.assert_allclose(observed.aabb_local.max_, [0.05, 0.1, 0.15], rtol=1e-6)


@pytest.mark.parametrize(
    ("size", "parts"),
    [
        (1e3, ["spindle.stl is 300 m wide, the robot reaches 1.8 m", "if it is in mm, scale: 0.001 would work"]),
        (70.0, ["spindle.stl is 21 m wide", "scale: 0.001 would work"]),
        (1e-3, ["spindle.stl is only 0.3 mm wide", "if it is in m, scale: 1000 would work"]),
    ],
)
def test_wrong_mesh_unit_is_reported_with_the_right_scale(folder: Path, size: float, parts: list[str]) -> None:
    (folder / "spindle.stl").write_bytes(export_mesh("stl", BOX.copy().apply_scale(size)))
    read_refusal_message(folder, "tool.geometry[0].mesh", *parts)
    replace_in_file(folder, "mesh: spindle.stl", f"mesh: spindle.stl, scale: {1 / size}")
    assert load_cell(folder).warnings == ()


def test_link_mesh_in_another_unit_is_reported(folder: Path) -> None:
    (folder / "link.stl").write_bytes(export_mesh("stl", BOX.copy().apply_scale(1e3)))
    read_refusal_message(folder, "robot.urdf: line 47", 'scale="0.001 0.001 0.001" in the URDF would work')
    replace_in_file(folder, 'filename="link.stl"', 'filename="link.stl" scale="0.001 0.001 0.001"', "robot.urdf")
    assert load_cell(folder).warnings == ()
    replace_in_file(folder, 'size="0.2 0.2 0.3"', 'size="200 200 300"', "robot.urdf", 1)
    read_refusal_message(
        folder, "robot.urdf: line 7: collision of link 'l1': a box is 300 m wide", "0.001 times as large"
    )


def test_open_and_inverted_surfaces_are_reported_with_their_consequence(folder: Path) -> None:
    (folder / "spindle.stl").write_bytes(
        export_mesh("stl", trimesh.Trimesh(BOX.vertices, BOX.faces[:-1], process=False))
    )
    turned = BOX.copy()
    turned.invert()
    (folder / "link.stl").write_bytes(export_mesh("stl", turned))
    warnings = load_cell(folder).warnings
    assert len(warnings) == 2
    assert "not closed: spindle.stl (3 open edges)" in warnings[0]
    assert "wholly inside one is not" in warnings[0]
    assert "face inwards: link.stl" in warnings[1]


def test_huge_file_is_refused_before_reading(folder: Path) -> None:
    with (folder / "spindle.stl").open("wb") as file:
        file.truncate(3 << 30)
    read_refusal_message(folder, "tool.geometry[0].mesh", "spindle.stl holds 3 GiB; expected a mesh of at most 128 MiB")


def test_millions_of_triangles_are_refused_before_allocation(folder: Path) -> None:
    with (folder / "spindle.stl").open("wb") as file:
        file.write(bytes(80) + struct.pack("<I", 2_500_000))
        file.truncate(84 + 50 * 2_500_000)
    read_refusal_message(
        folder, "tool.geometry[0].mesh", "holds 2500000 triangles; expected at most 2000000", "decimated"
    )


def test_mesh_that_is_a_pipe_or_a_folder_is_refused(folder: Path) -> None:
    import os

    (folder / "spindle.stl").unlink()
    os.mkfifo(folder / "spindle.stl")
    read_refusal_message(folder, "tool.geometry[0].mesh", "spindle.stl is a named pipe")
    (folder / "spindle.stl").unlink()
    (folder / "spindle.stl").mkdir()
    read_refusal_message(folder, "tool.geometry[0].mesh", "spindle.stl is a directory")
    (folder / "spindle.stl").rmdir()
    (folder / "spindle.stl").symlink_to("spindle.stl")
    read_refusal_message(folder, "tool.geometry[0].mesh", "links in a circle")
    replace_in_file(folder, "spindle.stl", "x" * 300 + ".stl")
    read_refusal_message(folder, "tool.geometry[0].mesh", "no such file: xxx")


@pytest.mark.parametrize("name", ["pipe", "/dev/zero", "../outside.mtl", "link.mtl", "."])
def test_material_libraries_outside_the_folder_are_not_opened(name: str, tmp_path: Path) -> None:
    """The verifier's importer opens the material library named in an OBJ, and would wait endlessly for a pipe."""
    folder = tmp_path / "meshes"
    folder.mkdir()
    os.mkfifo(folder / "pipe")
    (tmp_path / "outside.mtl").write_text("newmtl a\n")
    (folder / "link.mtl").symlink_to(tmp_path / "outside.mtl")
    trimesh.creation.box((0.1, 0.1, 0.1)).export(folder / "a.obj")
    text = (folder / "a.obj").read_text()
    (folder / "a.obj").write_text(f"mtllib {name}\n{text}")
    with pytest.raises(InputError, match="material library"):
        read_surface(folder / "a.obj", InputError)
    for ordinary in ("none.mtl", "a b.mtl"):
        (folder / "a.obj").write_text(f"mtllib {ordinary}\n{text}")
        assert read_surface(folder / "a.obj", InputError).open_edges == 0


SQUARES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CORNERS = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
ELL = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]


def obj_of(points: list[list[float]], faces: list[list[int]], more: str = "") -> str:
    lines = ["v " + " ".join(map(str, p)) for p in points] + ["f " + " ".join(str(k + 1) for k in f) for f in faces]
    return "\n".join(lines) + f"\n{more}"


def prism(first: int) -> str:
    """Build an L-shaped prism of height 1, with both ends starting at corner ``first``: a fan from there either stays
    within the L or exceeds it.

    In the second case the planner keeps a larger distance than necessary; the verifier's library triangulates by ear
    clipping.
    """
    points = [[x, y, z] for z in (0, 1) for x, y in ELL]
    ring = [(k + first) % 6 for k in range(6)]
    sides = [[k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6)]
    return obj_of(points, [[ring[0], *ring[:0:-1]], [k + 6 for k in ring], *sides])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (obj_of(CORNERS, SQUARES), ""),
        (obj_of(CORNERS, SQUARES, "l 1 2\np 1\nvt 0 0\ns off\ng a b\n"), ""),
        (prism(3), ""),
        (prism(1), ""),
        (prism(5), ""),
        (obj_of(CORNERS, SQUARES, "cstype bspline\ndeg 3\n"), "'cstype'"),
        (obj_of(CORNERS, SQUARES, "surf 0 1 0 1 1 2 3\nend\n"), "'surf'"),
        (obj_of(CORNERS, SQUARES, "curv 0 1 1 2\n"), "'curv'"),
        (obj_of(CORNERS, SQUARES, "  parm u 0 1\n"), "'parm'"),
        (obj_of(CORNERS, [*SQUARES, [0, 1, 2, 99]]), "a.obj"),
    ],
)
def test_obj_file_is_read_completely_or_refused(text: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "a.obj"
    file.write_text(text)
    if not words:
        assert read_surface(file, InputError).open_edges == 0
        return
    with pytest.raises(InputError, match=words):
        read_surface(file, InputError)
