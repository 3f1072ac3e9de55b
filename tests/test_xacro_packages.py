"""Packages in the layout of ROS-Industrial: macros, robot, meshes and limits in separate files.

Every variant is the same small arm, so its kinematics must equal that of the plain URDF; each becomes a cell without
changes.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_cell import urdf_text
from test_collada_variants import cube

from machopt.cell.urdf import read_standalone_description
from machopt.cell_setup.template.init_request import InitRequest
from machopt.commands.init import run_init
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_robot

XMLNS = 'xmlns:xacro="http://ros.org/wiki/xacro"'
LINK = '<collision><geometry><mesh filename="package://made_support/meshes/made/collision/link.stl"/></geometry></collision>'
Files = dict[str, str]


def body(prefix: str = "${prefix}") -> str:
    """Return the links and joints of the arm, with a prefix before every name."""
    text = urdf_text().removeprefix('<robot name="small">').removesuffix("</robot>")
    return re.sub(r'(<(?:link|joint) name="|(?:parent|child) link=")', rf"\g<1>{prefix}", text)


def macro(inside: str, params: str = "prefix", head: str = "") -> str:
    made = f'<xacro:macro name="made" params="{params}">{inside}</xacro:macro>'
    return f'<?xml version="1.0"?>\n<robot {XMLNS}>{head}{made}</robot>'


def robot(inside: str) -> str:
    return f'<?xml version="1.0"?>\n<robot name="small" {XMLNS}>{inside}</robot>'


INCLUDE = '<xacro:include filename="$(find made_support)/urdf/made_macro.xacro"/>'
CALL = '<xacro:made prefix=""/>'


def build_plain_package() -> Files:
    return {"urdf/made_macro.xacro": macro(body()), "urdf/made.xacro": robot(INCLUDE + CALL)}


def replace_in_macro(old: str, new: str, count: int = 1, **more: str) -> Files:
    text = body()
    assert old in text
    return {
        "urdf/made_macro.xacro": macro(text.replace(old, new, count)),
        "urdf/made.xacro": robot(INCLUDE + CALL),
        **more,
    }


def limits_of_yaml() -> Files:
    text = body().replace(
        'velocity="2" effort="1000"', "velocity=\"${limits['joint_limits']['a1'].max_velocity}\" effort=\"1000\"", 1
    )
    head = (
        '<xacro:property name="limits" value="${xacro.load_yaml(\'$(find made_support)/config/joint_limits.yaml\')}"/>'
    )
    return {
        "urdf/made_macro.xacro": macro(text, head=head),
        "urdf/made.xacro": robot(INCLUDE + CALL),
        "config/joint_limits.yaml": "joint_limits:\n  a1:\n    max_velocity: !degrees 114.591559\n    has: true\n",
    }


def build_nested_package() -> Files:
    return {
        "urdf/common/values.xacro": f'<robot {XMLNS}><xacro:property name="reach" value="${{1.0 + 0.15}}"/></robot>',
        "urdf/common/all.xacro": f'<robot {XMLNS}><xacro:include filename="values.xacro"/></robot>',
        "urdf/made_macro.xacro": macro(
            body().replace('xyz="1.15 0.0 0.0"', 'xyz="${reach} 0.0 0.0"'),
            head='<xacro:include filename="$(find made_support)/urdf/common/all.xacro"/>',
        ),
        "urdf/made.xacro": robot(INCLUDE + CALL),
    }


def name_space() -> Files:
    files = build_nested_package()
    text = files["urdf/made_macro.xacro"].replace("all.xacro", "values.xacro").replace("${reach}", "${own.reach}")
    return files | {"urdf/made_macro.xacro": text.replace('values.xacro"', 'values.xacro" ns="own"')}


def blocks() -> Files:
    text = body().replace('<origin xyz="0.0 0.0 0.675" rpy="0 0 0"/>', '<xacro:insert_block name="origin"/>')
    call = '<xacro:made prefix=""><origin xyz="0 0 0.675" rpy="0 0 0"/></xacro:made>'
    return {"urdf/made_macro.xacro": macro(text, "prefix *origin"), "urdf/made.xacro": robot(INCLUDE + call)}


def conditions() -> Files:
    text = body().replace(
        '<link name="${prefix}flange"/>',
        '<xacro:if value="${with_flange and reach > 1}"><link name="${prefix}flange"/></xacro:if>'
        '<xacro:unless value="${with_flange}"><link name="none"/></xacro:unless>',
    )
    params = "prefix:='' with_flange:=true reach:=${2.0 * 1}"
    return {"urdf/made_macro.xacro": macro(text, params), "urdf/made.xacro": robot(INCLUDE + "<xacro:made/>")}


def arguments() -> Files:
    args = '<xacro:arg name="model"/><xacro:arg name="prefix" default=""/><xacro:arg name="reach" default="1.15"/>'
    text = body().replace('xyz="1.15 0.0 0.0"', 'xyz="$(arg reach) 0.0 0.0"')
    call = '<xacro:made prefix="$(arg prefix)"/>'
    return {
        "urdf/made_macro.xacro": macro(text),
        "urdf/made.xacro": robot(args + INCLUDE.replace("made_macro", "$(arg model)_macro") + call),
    }


def plate() -> Files:
    text = body().replace(
        '<link name="${prefix}flange"/>',
        '<link name="${prefix}flange"/><link name="plate"><collision><geometry><box size="0.005 0.005 0.004"/>'
        '</geometry></collision></link><joint name="p" type="fixed"><parent link="${prefix}flange"/>'
        '<child link="plate"/></joint>',
    )
    return {"urdf/made_macro.xacro": macro(text), "urdf/made.xacro": robot(INCLUDE + CALL)}


def rods() -> Files:
    rod = (
        '<link name="rod"><collision><geometry><box size="0.5 0.05 0.05"/></geometry></collision></link>'
        '<joint name="r" type="continuous"><parent link="link_1"/><child link="rod"/><origin xyz="-0.2 0.3 0"/>'
        '<axis xyz="0 1 0"/><mimic joint="a2" multiplier="${-1.0}"/></joint>'
    )
    return {"urdf/made_macro.xacro": macro(body() + rod), "urdf/made.xacro": robot(INCLUDE + CALL)}


def fingers() -> Files:
    def finger(side: str, mimic: str = "") -> str:
        return (
            f'<link name="{side}"/><joint name="{side}_finger" type="prismatic"><parent link="flange"/>'
            f'<child link="{side}"/><axis xyz="0 1 0"/><limit lower="0" upper="0.04" velocity="0.2" effort="9"/>'
            f"{mimic}</joint>"
        )

    gripper = finger("left") + finger("right", '<mimic joint="left_finger" multiplier="-1"/>')
    return {"urdf/made_macro.xacro": macro(body() + gripper), "urdf/made.xacro": robot(INCLUDE + CALL)}


def global_scope() -> Files:
    head = '<xacro:property name="reach" value="9"/>'
    inside = '<xacro:property name="reach" value="${1.15}" scope="parent"/>'
    text = body().replace('xyz="1.15 0.0 0.0"', 'xyz="${reach} 0.0 0.0"')
    return {
        "urdf/made_macro.xacro": macro(text, head=head + f'<xacro:macro name="set">{inside}</xacro:macro>').replace(
            '<xacro:macro name="made" params="prefix">', '<xacro:macro name="made" params="prefix"><xacro:set/>'
        ),
        "urdf/made.xacro": robot(INCLUDE + CALL),
    }


def loop() -> Files:
    """A macro that calls itself writes six markers."""
    head = (
        '<xacro:macro name="mark" params="n"><link name="mark_${n}"/><joint name="m_${n}" type="fixed"><parent '
        'link="base_link"/><child link="mark_${n}"/></joint><xacro:if value="${n > 1}"><xacro:mark n="${n - 1}"/>'
        "</xacro:if></xacro:macro>"
    )
    return {
        "urdf/made_macro.xacro": macro(body(), head=head),
        "urdf/made.xacro": robot(INCLUDE + CALL + '<xacro:mark n="6"/>'),
    }


def collada() -> Files:
    files = replace_in_macro(
        '<link name="${prefix}link_1">', '<link name="${prefix}link_1">' + LINK.replace(".stl", ".dae")
    )
    return files | {"meshes/made/collision/link.dae": cube(asset='<unit meter="0.1"/>')}


def other_package() -> Files:
    files = build_nested_package()
    text = files["urdf/made_macro.xacro"].replace(
        "$(find made_support)/urdf/common/all", "$(find made_resources)/urdf/values"
    )
    return {
        "urdf/made_macro.xacro": text,
        "urdf/made.xacro": files["urdf/made.xacro"],
        "../made_resources/urdf/values.xacro": files["urdf/common/values.xacro"],
        "../made_resources/package.xml": "<package><name>made_resources</name></package>",
    }


def build_forwarded_package() -> Files:
    """Values of a YAML file are passed through macros into the caller's scope; one value names a package."""
    head = (
        '<xacro:macro name="read" params="file"><xacro:property name="config" value="${xacro.load_yaml(file)}"/>'
        '<xacro:property name="arm" value="${config[\'arm\']}" scope="parent"/></xacro:macro>'
        '<xacro:macro name="get" params="arm:=^"><xacro:property name="mesh" scope="parent" '
        "value=\"package://$(find_name ${arm['package']})\"/></xacro:macro>"
    ).replace("$(find_name ${arm['package']})", "${arm['package']}/meshes/made/collision/link.stl")
    call = '<xacro:read file="$(find made_support)/config/arm.yaml"/><xacro:get/>'
    link = LINK.replace("package://made_support/meshes/made/collision/link.stl", "${mesh}")
    text = body().replace('xyz="1.15 0.0 0.0"', "xyz=\"${arm['reach']} 0 0\"")
    text = text.replace('<link name="${prefix}link_1">', f'<link name="${{prefix}}link_1">{link}')
    made = macro(text, head=head).replace('params="prefix">', f'params="prefix">{call}')
    return {
        "urdf/made_macro.xacro": made,
        "urdf/made.xacro": robot(INCLUDE.replace("made_support", "${'made' + '_support'}") + CALL),
        "config/arm.yaml": "arm: {reach: 1.15, package: made_support, angle: !radians 1.5 * 2}\n",
    }


VARIANTS: dict[str, Callable[[], Files]] = {
    "plain": build_plain_package,
    "mathematics": lambda: replace_in_macro(
        'xyz="1.15 0.0 0.0"', 'xyz="${sqrt(1.15**2) * cos(radians(0))} 0 ${-pi/2 + pi/2}"'
    ),
    "formatted": lambda: replace_in_macro('xyz="1.15 0.0 0.0"', "xyz=\"${'%.3f' % 1.15} ${str(0)} ${round(0.001)}\""),
    "list": lambda: replace_in_macro('xyz="1.15 0.0 0.0"', "xyz=\"${' '.join(map(str, [1.15, 0, 0]))}\""),
    "byte_order_mark": lambda: {k: "\ufeff" + v for k, v in build_plain_package().items()},
    "mesh": lambda: replace_in_macro('<link name="${prefix}link_1">', '<link name="${prefix}link_1">' + LINK),
    "comments": lambda: replace_in_macro("</link>", "</link><!-- ${none} $(env HOME) <xacro:none/> -->"),
    "dollars": lambda: replace_in_macro(
        '<link name="${prefix}flange"/>', '<link name="${prefix}flange"/><gazebo>$${a} $$(b)</gazebo>'
    ),
    "limits_of_yaml": limits_of_yaml,
    "nested": build_nested_package,
    "forwarded": build_forwarded_package,
    "name_space": name_space,
    "blocks": blocks,
    "conditions": conditions,
    "arguments": arguments,
    "plate": plate,
    "rods": rods,
    "fingers": fingers,
    "global_scope": global_scope,
    "loop": loop,
    "collada": collada,
    "other_package": other_package,
}


def write_package(folder: Path, files: Files) -> Path:
    package = folder / "made_support"
    for name, text in files.items():
        file = (package / name).resolve()
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    (package / "package.xml").write_text("<package><name>made_support</name></package>")
    mesh = package / "meshes" / "made" / "collision" / "link.stl"
    mesh.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((0.2, 0.2, 0.2)).export(mesh)
    return package / "urdf" / "made.xacro"


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    folder = tmp_path_factory.mktemp("plain")
    (folder / "arm.urdf").write_text(urdf_text())
    request = InitRequest(robot=folder / "arm.urdf", out=folder / "cell", workpiece_mm=(1500.0, 0.0, 600.0))
    return load_robot(run_init(request).cell).compute_fk(np.linspace(-1.0, 1.0, 6))


@pytest.mark.parametrize("name", sorted(VARIANTS))
def test_package_becomes_a_cell_without_editing(name: str, expected: np.ndarray, tmp_path: Path) -> None:
    file = write_package(tmp_path, VARIANTS[name]())
    done = run_init(
        InitRequest(
            robot=file,
            out=tmp_path / "cell",
            workpiece_mm=(1500.0, 0.0, 600.0),
            xacro_args={"model": "made"} if name == "arguments" else {},
        )
    )
    np.testing.assert_allclose(load_robot(done.cell).compute_fk(np.linspace(-1.0, 1.0, 6)), expected, atol=1e-9)
    np.testing.assert_allclose(done.cell.limits.velocity[:6], 2.0, rtol=1e-5)


def test_two_arms_of_one_macro_have_their_prefixes(tmp_path: Path) -> None:
    call = '<link name="world"/>' + "".join(
        f'<xacro:made prefix="{p}_"/><joint name="{p}_on" type="fixed"><parent link="world"/>'
        f'<child link="{p}_base_link"/></joint>'
        for p in ("left", "right")
    )
    file = write_package(tmp_path, build_plain_package() | {"urdf/made.xacro": robot(INCLUDE + call)})
    links = read_standalone_description(file).urdf.links
    assert {"left_link_6", "right_link_6"} <= set(links)
    with pytest.raises(InputError, match="more than one arm"):
        run_init(InitRequest(robot=file, out=tmp_path / "cell"))
    done = run_init(InitRequest(robot=file, out=tmp_path / "cell", flange_link="left_flange"))
    assert done.cell.arm_joints[0] == "left_a1"
