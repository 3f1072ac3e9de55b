"""COLLADA meshes of a robot: read as RViz reads them, written as STL next to the URDF of the new cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_cell import urdf_text

from machopt.cell.mesh.collada_reader import build_binary_stl, read_collada
from machopt.cell_setup.template.init_request import InitRequest
from machopt.commands.init import run_init
from machopt.errors import InputError

FACES = {
    "triangles": '<triangles count="4">INPUT<p>0 9 1 9 2 9 0 9 3 9 1 9 0 9 2 9 3 9 1 9 3 9 2 9</p></triangles>',
    "polylist": '<polylist count="2">INPUT<vcount>3 4</vcount><p>0 9 1 9 2 9 0 9 1 9 2 9 3 9</p></polylist>',
    "polygons": '<polygons count="2">INPUT<p>0 9 1 9 2 9</p><p>0 9 1 9 2 9 3 9</p></polygons>',
}
INPUT = '<input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#n" offset="1"/>'
TEXT = """<?xml version="1.0"?>
<COLLADA version="1.4.1"><asset><unit name="inch" meter="0.0254"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array>
<technique_common>ACCESSOR</technique_common></source>
<source id="n"><float_array id="b" count="30">NORMALS</float_array>
<technique_common>ACCESSOR_OF_N</technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>FACES</mesh></geometry></library_geometries>
<library_nodes><node id="part"><scale>2 2 2</scale><instance_geometry url="#g"/></node></library_nodes>
<library_visual_scenes><visual_scene id="all">
<node><translate>10 0 0</translate><rotate>0 0 1 90</rotate><node><instance_node url="#part"/></node></node>
<node><matrix>1 0 0 0 0 1 0 0 0 0 1 5 0 0 0 1</matrix><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#all"/></scene></COLLADA>
"""
PARAMS = "".join(f'<param name="{name}" type="float"/>' for name in "XYZ")
TEXT = TEXT.replace("ACCESSOR_OF_N", f'<accessor source="#b" count="10" stride="3">{PARAMS}</accessor>')
TEXT = TEXT.replace("ACCESSOR", f'<accessor source="#a" count="4" stride="3">{PARAMS}</accessor>')
TEXT = TEXT.replace("NORMALS", " ".join(["0 0 1"] * 10))
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def write_collada(folder: Path, faces: str = "triangles", text: str = TEXT) -> Path:
    file = folder / "a.dae"
    file.write_text(text.replace("FACES", FACES[faces].replace("INPUT", INPUT)))
    return file


@pytest.mark.parametrize("faces", sorted(FACES))
def test_node_transforms_place_triangles_in_metres(faces: str, tmp_path: Path) -> None:
    """Two nodes: rotated by 90° about z, scaled by 2 and shifted; and shifted only. The unit applies, the up axis
    does not."""
    found = read_collada(write_collada(tmp_path, faces)).corners
    assert found.shape == (8 if faces == "triangles" else 6, 3, 3)
    first, second = np.split(found, 2)
    turned = 2 * CORNERS[:, [1, 0, 2]] * [-1, 1, 1] + [10, 0, 0]
    index = np.array(
        [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]] if faces == "triangles" else [[0, 1, 2]] * 2 + [[0, 2, 3]]
    )
    np.testing.assert_allclose(first, 0.0254 * turned[index], atol=1e-7)
    np.testing.assert_allclose(second, 0.0254 * np.add(CORNERS, [0, 0, 5])[index], atol=1e-7)
    assert len(build_binary_stl(found)) == 84 + 50 * len(found)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('source="#s"', 'source="#gone"', "names '#gone'"),
        ("0 9 1 9 2 9", "0 9 1 9 7 9", "names corners 0 to 7 of 4"),
        ("1 0 0 0 1 0 0 0 1<", "1 0 0 0 1 0 0 0 one<", "no number"),
        ("1 0 0 0 1 0 0 0 1<", "1 0 0 0 1 0 0 0 nan<", "not finite"),
        ("<scale>2 2 2</scale>", "<skew>1 2 2 2</skew>", "line 9: has a <skew>, which is not read"),
        ("<instance_geometry", '<instance_node url="#part"/><instance_geometry', "nodes more than 20 deep"),
        ("0 0 1 90", "0 0 2 90", "axis whose length"),
        ("COLLADA", "COLADA", "its root is <COLADA>"),
        ("<scene>", "<seen>", "is not XML"),
    ],
)
def test_unsupported_content_is_reported(old: str, new: str, told: str, tmp_path: Path) -> None:
    assert old in write_collada(tmp_path).read_text()
    file = write_collada(
        tmp_path, text=TEXT.replace("FACES", FACES["triangles"].replace("INPUT", INPUT)).replace(old, new)
    )
    with pytest.raises(InputError, match=told):
        read_collada(file)


def test_robot_with_collada_bodies_gets_a_cell_with_stl(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    body = '<collision><geometry><mesh filename="a.dae" scale="0.5 0.5 0.5"/></geometry></collision>'
    file.write_text(urdf_text().replace('<link name="link_1">', f'<link name="link_1">{body}'))
    write_collada(tmp_path)
    done = run_init(InitRequest(robot=file, out=tmp_path / "cell", workpiece_mm=(1500.0, 0.0, 600.0)))
    assert (done.folder / "a.dae.stl").read_bytes() == build_binary_stl(read_collada(tmp_path / "a.dae").corners)
    assert 'filename="a.dae.stl" scale="0.5 0.5 0.5"' in (done.folder / "robot.urdf").read_text()
