"""COLLADA variants of exporters: number of triangles, area and bounding box equal hand-calculated values.

A file contains a unit cube, a plane L with six corners, or a strip, each in many notations. The verifier's own library
also reads each file and must give the same body.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_cell import urdf_text

from machopt.cell.cell_reader import load_cell
from machopt.cell.mesh.collada_reader import build_binary_stl, read_collada
from machopt.cell.mesh.polygon_triangulation import triangulate_polygons
from machopt.cell.mesh.second_library_check import compare_bodies, load_with_second_library
from machopt.cell_setup.template.init_request import InitRequest
from machopt.commands.init import run_init
from machopt.errors import InputError
from machopt.verification.motion.collision.original_meshes import load_mesh

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
TRIANGLES = [[q[0], q[k], q[k + 1]] for q in QUADS for k in (1, 2)]
# area 3; a fan from corner 5 does not triangulate it
L = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]], float)
ELL = [5, 0, 1, 2, 3, 4]
XMLNS = ' xmlns="http://www.collada.org/2005/11/COLLADASchema"'


def words(values: object) -> str:
    return " ".join(f"{v:.9g}" for v in np.ravel(np.asarray(values, float)))


def source(name: str, points: np.ndarray, text: str | None = None) -> str:
    params = "".join(f'<param name="{c}" type="float"/>' for c in "XYZ")
    return (
        f'<source id="{name}"><float_array id="{name}-a" count="{points.size}">{text or words(points)}</float_array>'
        f'<technique_common><accessor source="#{name}-a" count="{len(points)}" stride="3">{params}</accessor>'
        "</technique_common></source>"
    )


def geometry(points: np.ndarray, faces: str, name: str = "g", text: str | None = None, more: str = "") -> str:
    return (
        f'<geometry id="{name}"><mesh>{source(f"{name}-p", points, text)}{more}<vertices id="{name}-v">'
        f'<input semantic="POSITION" source="#{name}-p"/></vertices>{faces}</mesh></geometry>'
    )


def vertex(name: str = "g", offset: int = 0) -> str:
    return f'<input semantic="VERTEX" source="#{name}-v" offset="{offset}"/>'


def triangles(rows: object = TRIANGLES, name: str = "g") -> str:
    index = np.ravel(np.asarray(rows))
    return f'<triangles count="{len(index) // 3}">{vertex(name)}<p>{words(index)}</p></triangles>'


def document(
    geometries: str,
    nodes: str = '<node><instance_geometry url="#g"/></node>',
    *,
    asset: str = '<unit meter="1" name="meter"/><up_axis>Z_UP</up_axis>',
    library: str = "",
    namespace: str = XMLNS,
    version: str = "1.4.1",
) -> str:
    return (
        f'<?xml version="1.0" encoding="utf-8"?><COLLADA{namespace} version="{version}"><asset>{asset}</asset>{library}'
        f"<library_geometries>{geometries}</library_geometries><library_visual_scenes><visual_scene id='s'>{nodes}"
        "</visual_scene></library_visual_scenes><scene><instance_visual_scene url='#s'/></scene></COLLADA>"
    )


def cube(faces: str | None = None, **more: str) -> str:
    return document(geometry(CUBE, faces or triangles()), **more)  # type: ignore[arg-type]


def polylist(rows: list[list[int]]) -> str:
    index, counts = [k for row in rows for k in row], [len(r) for r in rows]
    return f'<polylist count="{len(rows)}">{vertex()}<vcount>{words(counts)}</vcount><p>{words(index)}</p></polylist>'


def build_polygons(tag: str, rows: list[list[int]]) -> str:
    return f'<{tag} count="{len(rows)}">{vertex()}{"".join(f"<p>{words(r)}</p>" for r in rows)}</{tag}>'


def with_inputs() -> str:
    """The vertex index is the third of four indices."""
    index = np.stack([np.zeros(36, int), np.arange(36) % 6, np.ravel(TRIANGLES), np.zeros(36, int)], axis=1)
    inputs = (
        '<input semantic="NORMAL" source="#n" offset="1"/><input semantic="TEXCOORD" source="#n" offset="0" set="0"/>'
    )
    inputs += vertex(offset=2) + '<input semantic="COLOR" source="#n" offset="3"/>'
    faces = f'<triangles count="12">{inputs}<p>{words(index)}</p></triangles>'
    return document(geometry(CUBE, faces, more=source("n", np.eye(3).repeat(2, axis=0))))


def node(moves: str, inside: str = '<instance_geometry url="#g"/>') -> str:
    return f"<node>{moves}{inside}</node>"


def grid(n: int) -> str:
    """Return n × n unit squares as triangles: a large file."""
    x, y = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3).astype(float)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    rows = np.concatenate([np.stack([a, a + n + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + 1], 1)])
    return document(geometry(points, triangles(rows)))


STRIP = np.array([[k // 2, k % 2, 0] for k in range(8)], float)  # six triangles in a strip, area 3
FAN = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
PLACED = '<instance_geometry url="#g"/>'
BROKEN_EFFECT = (
    '<library_images/><library_effects><effect id="e"><profile_COMMON><newparam sid="s"><sampler2D>'
    "<source>none</source></sampler2D></newparam>"
    '<technique sid="c"><phong><diffuse><texture texture="s" texcoord="t"/></diffuse></phong>'
    '</technique></profile_COMMON></effect></library_effects><library_materials><material id="m"><instance_effect '
    'url="#gone"/></material></library_materials>'
)
BOUND = (
    '<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="m" target="#m"/>'
    "</technique_common></bind_material></instance_geometry>"
)
ONE, TWO = [[0, 0, 0], [1, 1, 1]], [[0, 0, 0], [2, 2, 2]]
READ: dict[str, tuple[Callable[[], str], int, float, list[list[float]]]] = {
    # name: (text, triangles, area m², box m)
    "triangles": (cube, 12, 6, ONE),
    "no_name_space": (lambda: cube(namespace=""), 12, 6, ONE),
    "collada_1_5": (
        lambda: cube(namespace=' xmlns="http://www.collada.org/2008/03/COLLADASchema"', version="1.5.0"),
        12,
        6,
        ONE,
    ),
    "polylist": (lambda: cube(polylist(QUADS)), 12, 6, ONE),
    "polylist_mixed": (lambda: cube(polylist([*QUADS[:5], *TRIANGLES[10:]])), 12, 6, ONE),
    "polygons": (lambda: cube(build_polygons("polygons", QUADS)), 12, 6, ONE),
    "two_groups": (lambda: cube(triangles(TRIANGLES[:6]) + polylist(QUADS[3:])), 12, 6, ONE),
    "lines_beside": (lambda: cube(triangles() + f'<lines count="1">{vertex()}<p>0 1</p></lines>'), 12, 6, ONE),
    "concave": (lambda: document(geometry(L, polylist([ELL]))), 4, 3, [[0, 0, 0], [2, 2, 0]]),
    "concave_polygons": (
        lambda: document(geometry(L, build_polygons("polygons", [ELL]))),
        4,
        3,
        [[0, 0, 0], [2, 2, 0]],
    ),
    "strip": (
        lambda: document(geometry(STRIP, build_polygons("tristrips", [[*range(8)]]))),
        6,
        3,
        [[0, 0, 0], [3, 1, 0]],
    ),
    "strips": (
        lambda: document(geometry(STRIP, build_polygons("tristrips", [[*range(4)], [*range(2, 8)]]))),
        6,
        3,
        [[0, 0, 0], [3, 1, 0]],
    ),
    "fan": (lambda: document(geometry(FAN, build_polygons("trifans", [[0, 1, 2, 3]]))), 2, 1, [[0, 0, 0], [1, 1, 0]]),
    "inputs_with_offsets": (with_inputs, 12, 6, ONE),
    "two_geometries": (
        lambda: document(
            geometry(CUBE, triangles()) + geometry(CUBE + 1, triangles(name="h"), "h"),
            node("") + node("", '<instance_geometry url="#h"/>'),
        ),
        24,
        12,
        TWO,
    ),
    "two_in_one_node": (
        lambda: document(
            geometry(CUBE, triangles()) + geometry(CUBE + 1, triangles(name="h"), "h"),
            node("", PLACED + '<instance_geometry url="#h"/>'),
        ),
        24,
        12,
        TWO,
    ),
    "placed_twice": (lambda: cube(nodes=node("") + node("<translate>1 1 1</translate>")), 24, 12, TWO),
    "never_placed": (
        lambda: document(geometry(CUBE, triangles()) + geometry(CUBE * 9, triangles(name="h"), "h")),
        12,
        6,
        ONE,
    ),
    "moves_in_order": (
        lambda: cube(nodes=node("<translate>10 0 0</translate><rotate>0 0 1 90</rotate><scale>2 1 1</scale>")),
        12,
        10,
        [[9, 0, 0], [10, 2, 1]],
    ),
    "node_in_node": (
        lambda: cube(
            nodes=node(
                "<translate>1 0 0</translate>", node("<scale>2 2 2</scale>", node("<translate>1 0 0</translate>"))
            )
        ),
        12,
        24,
        [[3, 0, 0], [5, 2, 2]],
    ),
    "matrix": (
        lambda: cube(nodes=node("<matrix>1 0 0 0 0 1 0 0 0 0 1 5 0 0 0 1</matrix>")),
        12,
        6,
        [[0, 0, 5], [1, 1, 6]],
    ),
    "mirrored": (lambda: cube(nodes=node("<scale>-1 1 1</scale>")), 12, 6, [[-1, 0, 0], [0, 1, 1]]),
    "instance_node": (
        lambda: cube(
            library=f"<library_nodes><node id='n'><scale>2 2 2</scale>{PLACED}</node></library_nodes>",
            nodes=node("<translate>1 0 0</translate>", '<instance_node url="#n"/>'),
        ),
        12,
        24,
        [[1, 0, 0], [3, 2, 2]],
    ),
    "millimetres": (
        lambda: cube(asset='<unit name="millimeter" meter="0.001"/><up_axis>Z_UP</up_axis>'),
        12,
        6e-6,
        [[0, 0, 0], [1e-3] * 3],
    ),
    "inches": (lambda: cube(asset='<unit meter="0.0254" name="inch"/>'), 12, 6 * 0.0254**2, [[0, 0, 0], [0.0254] * 3]),
    "no_unit": (lambda: cube(asset="<up_axis>Z_UP</up_axis>"), 12, 6, ONE),
    "y_up": (
        lambda: cube(asset="<up_axis>Y_UP</up_axis>", nodes=node("<translate>0 0 1</translate>")),
        12,
        6,
        [[0, 0, 1], [1, 1, 2]],
    ),
    "x_up": (
        lambda: cube(asset="<up_axis>X_UP</up_axis>", nodes=node("<translate>0 0 1</translate>")),
        12,
        6,
        [[0, 0, 1], [1, 1, 2]],
    ),
    "comments_in_text": (
        lambda: document(geometry(CUBE, triangles(), text=words(CUBE).replace(" ", " <!-- a --> ", 5))),
        12,
        6,
        ONE,
    ),
    "lines_of_text": (lambda: cube().replace(" 0 ", "\n0\n"), 12, 6, ONE),
    "character_references": (
        lambda: document(geometry(CUBE, triangles(), text=words(CUBE).replace(" ", "&#10;"))),
        12,
        6,
        ONE,
    ),
    "sections": (
        lambda: document(geometry(CUBE, triangles(), text=f"<![CDATA[{words(CUBE[:4])}]]> {words(CUBE[4:])}")),
        12,
        6,
        ONE,
    ),
    "broken_material": (
        lambda: cube(
            triangles().replace("<triangles", '<triangles material="m"'), library=BROKEN_EFFECT, nodes=node("", BOUND)
        ),
        12,
        6,
        ONE,
    ),
    "lights_and_cameras": (
        lambda: cube(
            nodes=node("", '<instance_light url="#gone"/>') + node("") + node("", '<instance_camera url="#gone"/>')
        ),
        12,
        6,
        ONE,
    ),
    "large": (lambda: grid(150), 45000, 22500, [[0, 0, 0], [150, 150, 0]]),
}


def write_collada(folder: Path, text: str) -> Path:
    file = folder / "a.dae"
    file.write_text(text, encoding="utf-8")
    return file


def area(corners: np.ndarray) -> float:
    return float(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    )


def build_error(message: str) -> InputError:
    return InputError(message)


@pytest.mark.parametrize("name", sorted(READ))
def test_variant_has_the_triangles_counted_by_hand(name: str, tmp_path: Path) -> None:
    text, count, surface, box = READ[name]
    file = write_collada(tmp_path, text())
    found = read_collada(file)
    assert found.corners.shape == (count, 3, 3)
    assert area(found.corners) == pytest.approx(surface, rel=1e-6)
    points = found.corners.reshape(-1, 3)
    np.testing.assert_allclose([points.min(0), points.max(0)], box, atol=1e-6 * np.max(box))
    if name not in ("lights_and_cameras",):  # an undefined reference stops the other library
        other = load_with_second_library(file, found.counts.metre, build_error)
        compare_bodies(file.name, other, points, np.arange(3 * count).reshape(-1, 3), build_error)
        copy = tmp_path / "a.dae.stl"
        copy.write_bytes(build_binary_stl(found.corners))
        assert load_mesh(copy, np.full(3, 0.5)).num_tris == pytest.approx(count, abs=1 + 0.01 * count)


def holes() -> str:
    return f'<polygons count="1">{vertex()}<ph><p>0 1 3 2</p><h>4 5 7</h></ph></polygons>'


SKIN = (
    '<library_controllers><controller id="k"><skin source="#g"><joints/><vertex_weights count="0"/></skin></controller>'
    "</library_controllers>"
)
REFUSED: dict[str, Callable[[], str]] = {
    "holes": lambda: cube(holes()),
    "skin": lambda: cube(library=SKIN, nodes=node("", '<instance_controller url="#k"/>')),
    "skin_beside": lambda: cube(library=SKIN, nodes=node("") + node("", '<instance_controller url="#k"/>')),
    "spline": lambda: document('<geometry id="g"><spline/></geometry>'),
    "skew": lambda: cube(nodes=node("<skew>45 1 0 0 0 1 0</skew>")),
    "count_above": lambda: cube().replace('<triangles count="12"', '<triangles count="13"'),
    "count_below": lambda: cube().replace('<triangles count="12"', '<triangles count="11"'),
    "cut_indices": lambda: cube().replace("</p>", "</p>").replace(" 1 7 3<", " 1<"),
    "cut_points": lambda: cube().replace(" 1 1 1</float_array>", "</float_array>"),
    "cut_both": lambda: cube().replace('count="24"', 'count="21"').replace(" 1 1 1</float_array>", "</float_array>"),
    "cut_number": lambda: cube().replace(" 1 1 1</float_array>", " 1 1</float_array>"),
    "no_number": lambda: cube().replace(" 1 1 1</float_array>", " 1 1 one</float_array>"),
    "decimal_comma": lambda: cube().replace(" 1 1 1</float_array>", " 1 1 1,5</float_array>"),
    "not_finite": lambda: cube().replace(" 1 1 1</float_array>", " 1 1 NaN</float_array>"),
    "index_beyond": lambda: cube().replace(" 1 7 3<", " 1 7 8<"),
    "index_negative": lambda: cube().replace(" 1 7 3<", " 1 7 -1<"),
    "index_no_whole": lambda: cube().replace(" 1 7 3<", " 1 7 2.5<"),
    "vcount": lambda: cube(polylist(QUADS).replace("<vcount>4", "<vcount>3")),
    "vcount_negative": lambda: cube(polylist(QUADS).replace("<vcount>4", "<vcount>-4")),
    "no_scene": lambda: cube().replace("<instance_visual_scene url='#s'/>", ""),
    "other_scene": lambda: cube().replace("url='#s'", "url='#t'"),
    "other_geometry": lambda: cube(nodes=node("", '<instance_geometry url="#h"/>')),
    "other_file": lambda: cube(nodes=node("", '<instance_geometry url="b.dae#g"/>')),
    "empty_scene": lambda: cube(nodes=node("", "")),
    "node_in_itself": lambda: cube(
        library=f"<library_nodes><node id='n'>{PLACED}<instance_node url='#n'/></node></library_nodes>",
        nodes=node("", '<instance_node url="#n"/>'),
    ),
    "doubling_nodes": lambda: cube(
        library="<library_nodes>"
        + "".join(f"<node id='n{k}'>{2 * f'<instance_node url=%s#n{k + 1}%s/>'}</node>" for k in range(18)).replace(
            "%s", "'"
        )
        + f"<node id='n18'>{PLACED}</node></library_nodes>",
        nodes=node("", '<instance_node url="#n0"/>'),
    ),
    "matrix_cut": lambda: cube(nodes=node("<matrix>1 0 0 0 0 1 0 0 0 0 1 5</matrix>")),
    "unit_zero": lambda: cube(asset='<unit meter="0"/>'),
    "entities": lambda: cube().replace("<COLLADA", '<!DOCTYPE COLLADA [<!ENTITY a "1 1 1">]><COLLADA', 1),
    "stride_two": lambda: cube().replace('stride="3"', 'stride="2"'),
    "params_swapped": lambda: cube().replace('name="X"', 'name="Q"'),
}


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_content_that_would_be_dropped_or_moved_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        read_collada(write_collada(tmp_path, REFUSED[name]()))
    assert str(tmp_path) in str(refused.value)


@pytest.mark.parametrize("seed", range(12))
def test_any_simple_polygon_is_triangulated_to_its_area(seed: int) -> None:
    """Star-shaped polygons about an interior point, in a random plane, with any first corner and in either
    direction."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 40))
    angle = np.sort(rng.random(n)) * 2 * np.pi
    radius = rng.uniform(0.2, 1.0, n)
    flat = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(n)], axis=1)
    x, y = flat[:, 0], flat[:, 1]
    wanted = abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    order = np.roll(np.arange(n), int(rng.integers(n)))[:: (1 if seed % 2 else -1)]
    found = triangulate_polygons(flat @ R.T, order, np.array([n]))
    assert found.shape == (n - 2, 3, 3)
    assert area(found) == pytest.approx(wanted, rel=1e-9)


def robot_with_mesh(folder: Path) -> Path:
    file = folder / "arm.urdf"
    body = '<collision><geometry><mesh filename="a.dae" scale="0.2 0.2 0.2"/></geometry></collision>'
    file.write_text(urdf_text().replace('<link name="link_1">', f'<link name="link_1">{body}'))
    write_collada(folder, cube(nodes=node("<translate>-0.5 -0.5 -0.5</translate>")))
    return file


@pytest.mark.parametrize(("axis", "notes"), [("X_UP", 1), ("Y_UP", 1), ("Z_UP", 0)])
def test_unused_axis_causes_a_note(axis: str, notes: int, tmp_path: Path) -> None:
    robot = robot_with_mesh(tmp_path)
    (tmp_path / "a.dae").write_text((tmp_path / "a.dae").read_text().replace("Z_UP", axis))
    assert len(run_init(InitRequest(robot=robot, out=tmp_path / "cell")).notes) == notes


def test_copy_with_missing_triangles_is_refused(tmp_path: Path) -> None:
    """Planner and verifier read different copies: the original is stored next to the STL copy and is also an input
    of the cell."""
    done = run_init(InitRequest(robot=robot_with_mesh(tmp_path), out=tmp_path / "cell"))
    copy = done.folder / "a.dae.stl"
    assert (done.folder / "a.dae").read_bytes() == (tmp_path / "a.dae").read_bytes()
    assert {"a.dae", "a.dae.stl"} <= {f.name for f in load_cell(done.folder).files}
    outside = tmp_path / "outside.dae"
    (done.folder / "a.dae").rename(outside)
    (done.folder / "a.dae").symlink_to(outside)
    with pytest.raises(InputError, match="--allow-external"):
        load_cell(done.folder)
    assert len(load_cell(done.folder, allow_external=True).files) > 0
    whole = read_collada(tmp_path / "a.dae").corners
    copy.write_bytes(build_binary_stl(whole[:8]))
    with pytest.raises(InputError, match=r"a\.dae is read differently"):
        load_cell(done.folder, allow_external=True)
    assert load_mesh(copy, np.full(3, 0.2)).num_tris == 12  # the verifier's own copy
