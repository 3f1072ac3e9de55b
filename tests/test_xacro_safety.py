"""Expressions of robot files are safe: no Python evaluation, no other files, bounded memory.

Every attack below is tested in three routes: a file with the suffix ``.urdf``, one with ``.xacro``, and a cell folder.
A refusal is exit code 2; no code is executed, which a marker file would show.
"""

from __future__ import annotations

import math
import tracemalloc
from pathlib import Path

import pytest
from small_cell import urdf_text

from machopt.cell.cell_reader import load_cell
from machopt.cell.urdf import read_robot, read_standalone_description
from machopt.cell.urdf.xacro_expression import EvaluationBudget, XacroExpressionError, evaluate_expression
from machopt.cell.urdf.xacro_functions import build_symbols
from machopt.cli import main
from machopt.errors import InputError

SYSTEM = "__import__('os').system('touch MARK')"
ESCAPES = {
    "lambda": f"(lambda: {SYSTEM})()",
    "lambda_subclasses": "(lambda: [c for c in ().__class__.__base__.__subclasses__()])()",
    "lambda_in_lambda": "(lambda f: f(f))(lambda g: (lambda: g.__globals__)())",
    "lambda_default": f"(lambda x={SYSTEM}: x)()",
    "attribute": "().__class__",
    "attribute_chain": "(1).__class__.__mro__[1].__subclasses__()",
    "function_globals": "radians.__self__",
    "function_of_table": "xacro.load_yaml.__globals__['os'].system('touch MARK')",
    "call_of_function": "xacro.load_yaml.call.__globals__",
    "function_field": "sin.name",
    "dunder_name": "__builtins__",
    "dunder_import": SYSTEM,
    "list_comprehension": "[x for x in (1,)]",
    "set_comprehension": "len(set(x for x in [1]))",
    "dict_comprehension": "{k: k.__class__ for k in [1]}",
    "generator_frame": "(x for x in [1]).gi_frame.f_back.f_globals",
    "generator_code": "list((lambda: (yield))().gi_code)",
    "f_string": "f'{().__class__}'",
    "f_string_call": f'f"{{{SYSTEM}}}"',
    "walrus": "(y := sin)",
    "format": "'{0.__class__}'.format(1)",
    "format_map": "'{a.__class__}'.format_map(dict(a=1))",
    "getattr": "getattr(1, '__class__')",
    "eval": "eval('1')",
    "exec": "exec('1')",
    "open": "open('MARK', 'w')",
    "type": "python.type(1)",
    "type_three": "python.type('X', (), {})",
    "vars": "python.vars(xacro)",
    "vars_direct": "vars()",
    "subscript": "[].append.__self__",
    "subscript_name": "math['__loader__']",
    "subscript_dict": "xacro['load_yaml']['__globals__']",
    "map_of_method": "map(''.join, [])",
    "map_of_lambda": "map(lambda x: x, [1])",
    "starred": "max(*[1, 2])",
    "double_starred": "dict(**{'a': 1})",
    "ellipsis": "...",
    "bytes": "b'a'",
    "complex": "1j",
    "matrix": "1 @ 2",
    "await": "await 1",
    "private": "_private",
    "statement": "import os",
    "two_lines": "1\nimport os",
    "text_of_table": "str(math)",
    "text_of_function": "str(sin)",
}
BOMBS = {
    "power": "9**9**9",
    "power_of_two": "2**100000000",
    "power_of_power": "(2**500)**500",
    "text": "'a'*10**9",
    "text_reversed": "10**9*'a'",
    "list": "[1]*10**9",
    "nested_list": "str([[[1]*1000]*1000]*1000)",
    "format_width": "'%099999999d' % 1",
    "format_star": "'%*d' % (99999999, 1)",
    "replace": "('a'*20000).replace('a', 'b'*20000)",
    "replace_counted": "('a'*20000).replace('a', 'b'*20000, 10**9)",
    "join": "('a'*20000).join(['b']*20000)",
    "round": "round(5, -10**9)",
    "range": "range(10**9)",
    "factorial": "factorial(10**6)",
    "parentheses": "(" * 2000 + "1" + ")" * 2000,
    "signs": "-" * 3000 + "1",
    "long": "1" + "+1" * 5000,
    "digits": "9" * 5000,
    "shift": "1 << 10**9",
}


def robot(expression: str) -> str:
    quoted = expression.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    value = f'<xacro:property name="p" value="${{{quoted}}}"/><link name="x${{p}}"/>'
    start = urdf_text().replace("<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" ', 1)
    joint = '<joint name="xj" type="fixed"><parent link="flange"/><child link="x${p}"/></joint>'
    return start.replace("</robot>", f"{value}{joint}</robot>")


def refused_everywhere(text: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    for name in ("arm.urdf", "arm.urdf.xacro"):
        (folder / name).write_text(text)
        assert main(["inspect", name, "--json"]) == 2
        assert main(["init", name, "-o", "made"]) == 2
    cell = folder / "cell"
    cell.mkdir()
    (cell / "arm.urdf").write_text(text)
    (cell / "cell.yaml").write_text(
        "machopt_cell: 1\nname: c\nrobot: {urdf: arm.urdf, base_link: base_link, flange_link: flange, "
        "home_deg: [0, -90, 90, 0, 45, 0], limits: {acceleration_deg_s2: [300, 300, 300, 500, 500, 800], "
        "jerk_deg_s3: [2000, 2000, 2000, 4000, 4000, 6000]}}\ntool: {tcp: {xyz_mm: [0, 0, 350]}}\n"
        "workpiece: {pose: {xyz_mm: [1500, 0, 600]}}\n"
    )
    with pytest.raises(InputError):
        load_cell(cell)
    assert main(["validate", "cell"]) == 2
    assert not (folder / "MARK").exists()
    assert not (folder / "made").exists()


@pytest.mark.parametrize("name", sorted(ESCAPES))
def test_escape_is_refused(name: str) -> None:
    with pytest.raises(XacroExpressionError):
        evaluate_expression(ESCAPES[name], symbols())


@pytest.mark.parametrize("name", sorted(BOMBS))
def test_growth_is_refused_before_it_is_computed(name: str) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(XacroExpressionError):
            evaluate_expression(BOMBS[name], symbols())
        assert tracemalloc.get_traced_memory()[1] < 50e6  # bytes
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "name", ["lambda", "lambda_subclasses", "generator_frame", "f_string", "walrus", "format", "function_of_table"]
)
def test_escape_is_refused_in_every_route(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    refused_everywhere(robot(ESCAPES[name]), tmp_path, monkeypatch)
    assert "Traceback" not in capsys.readouterr().err


PLACES = {
    "if": '<xacro:if value="${EXPR}"><link name="l"/></xacro:if>',
    "unless": '<xacro:unless value="${EXPR}"><link name="l"/></xacro:unless>',
    "argument_default": '<xacro:arg name="a" default="${EXPR}"/><link name="$(arg a)"/>',
    "macro_default": '<xacro:macro name="m" params="a:=${EXPR}"><link name="${a}"/></xacro:macro><xacro:m/>',
    "macro_argument": '<xacro:macro name="m" params="a"><link name="${a}"/></xacro:macro><xacro:m a="${EXPR}"/>',
    "include": '<xacro:include filename="${EXPR}"/>',
    "include_name_space": '<xacro:include filename="x" ns="${EXPR}"/>',
    "element": '<xacro:element xacro:name="${EXPR}"/>',
    "attribute": '<link name="l"><xacro:attribute name="name" value="${EXPR}"/></link>',
    "call": '<xacro:call macro="${EXPR}"/>',
    "text": "<link name='l'>${EXPR}</link>",
    "comment": "<!-- xacro:eval-comments --><!-- ${EXPR} --><link name='l'/>",
    "property_name": '<xacro:property name="${EXPR}" value="1"/>',
    "property_scope": '<xacro:property name="p" scope="global" value="${EXPR}"/>',
    "lazy": '<xacro:property name="p" lazy_eval="false" value="${EXPR}"/>',
    "nested": '<link name="${${EXPR}}"/>',
    "extension": '<link name="$(arg ${EXPR})"/>',
    "roslaunch": '<link name="$(eval EXPR )"/>',
    "yaml": "<link name=\"${xacro.load_yaml('a.yaml')}\"/>",
}


@pytest.mark.parametrize("place", sorted(PLACES))
def test_escape_is_refused_in_every_evaluation(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    escape = "(lambda: ().__class__.__base__.__subclasses__())()"
    if place == "roslaunch":  # the package ends such a substitution at the first bracket
        escape = "open"
    text = PLACES[place].replace("EXPR", escape)
    (tmp_path / "a.yaml").write_text(f"a: !degrees '{escape}'\n")
    (tmp_path / "r.xacro").write_text(f'<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">{text}</robot>')
    with pytest.raises(InputError):
        read_robot(tmp_path / "r.xacro")


def build_doubling_chain(start: str, step: str) -> str:
    return start + "".join(step.replace("NEW", f"p{n + 1}").replace("OLD", f"p{n}") for n in range(60))


GROWING = {
    "properties": build_doubling_chain(
        '<xacro:property name="p0" value="aaaaaaaaaa"/>', '<xacro:property name="NEW" value="${OLD}${OLD}"/>'
    )
    + '<link name="${p60}"/>',
    "sums": build_doubling_chain(
        "<xacro:property name='p0' value='aaaaaaaaaa'/>", '<xacro:property name="NEW" value="${OLD+OLD}"/>'
    )
    + '<link name="${p60}"/>',
    "lists": build_doubling_chain(
        "<xacro:property name='p0' value='${[1]}'/>", '<xacro:property name="NEW" value="${[OLD, OLD]}"/>'
    )
    + '<link name="${p60}"/>',
    "macros": build_doubling_chain(
        '<xacro:macro name="p0"><link name="l"/></xacro:macro>',
        '<xacro:macro name="NEW"><xacro:OLD/><xacro:OLD/></xacro:macro>',
    )
    + "<xacro:p60/>",
    "blocks": build_doubling_chain(
        '<xacro:property name="p0"><link name="l"/></xacro:property>',
        '<xacro:property name="NEW"><xacro:insert_block name="OLD"/><xacro:insert_block name="OLD"/></xacro:property>',
    )
    + '<xacro:insert_block name="p60"/>',
    "endless": '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
    "itself": '<xacro:include filename="r.xacro"/>',
    "circle": '<xacro:property name="a" value="${b}"/><xacro:property name="b" value="${a}"/><link name="${a}"/>',
    "anchors": "<link name=\"${str(xacro.load_yaml('a.yaml'))}\"/>",
    "merges": "<link name=\"${str(xacro.load_yaml('m.yaml'))}\"/>",
    "python_tag": "<link name=\"${xacro.load_yaml('t.yaml')}\"/>",
}


@pytest.mark.parametrize("name", sorted(GROWING))
def test_unbounded_growth_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(
        "p0: &p0 [a, a]\n" + "".join(f"p{n + 1}: &p{n + 1} [*p{n}, *p{n}]\n" for n in range(40))
    )
    (tmp_path / "m.yaml").write_text(
        "p0: &p0 {a: 1}\n" + "".join(f"p{n + 1}: &p{n + 1} {{<<: [*p{n}, *p{n}]}}\n" for n in range(40))
    )
    (tmp_path / "t.yaml").write_text("a: !!python/object/apply:os.system ['touch MARK']\n")
    (tmp_path / "r.xacro").write_text(
        f'<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">{GROWING[name]}</robot>'
    )
    with pytest.raises(InputError):
        read_robot(tmp_path / "r.xacro")


XML = {
    "entities": '<!DOCTYPE robot [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>',
    "external_entity": '<!DOCTYPE robot [<!ENTITY a SYSTEM "file:///etc/hostname">]>',
    "external_dtd": '<!DOCTYPE robot SYSTEM "other.dtd">',
    "parameter_entity": "<!DOCTYPE robot [<!ENTITY % a \"<!ENTITY b 'c'>\"> %a;]>",
}


@pytest.mark.parametrize("name", sorted(XML))
@pytest.mark.parametrize("included", [False, True])
def test_document_types_and_entities_are_refused(name: str, included: bool, tmp_path: Path) -> None:
    body = '<xacro:if value="1"><link name="l"/></xacro:if></robot>'
    body = f'<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">{body}'
    (tmp_path / "r.xacro").write_text(f"<?xml version='1.0'?>{XML[name]}{body}")
    (tmp_path / "main.xacro").write_text(body.replace("<xacro:if", '<xacro:include filename="r.xacro"/><xacro:if'))
    with pytest.raises(InputError, match=r"document type|entities"):
        read_robot(tmp_path / ("main.xacro" if included else "r.xacro"))


@pytest.mark.parametrize(
    "wanted",
    [
        '<xacro:include filename="{out}/o.xacro"/>',
        '<xacro:include filename="../../outside/o.xacro"/>',
        "<xacro:include filename=\"${{'{out}' + '/o.xacro'}}\"/>",
        '<xacro:include filename="{out}/*.xacro"/>',
        '<xacro:include filename="/*/*/o.xacro"/>',
        "<link name=\"${{xacro.load_yaml('{out}/o.yaml')['a']}}\"/>",
        "<link name=\"${{xacro.load_yaml('/dev/zero')}}\"/>",
        '<xacro:include filename="link/o.xacro"/>',
        '<xacro:include filename="$(find ../../outside)/o.xacro"/>',
        '<xacro:include filename="$(find ..)/outside/o.xacro"/>',
        '<xacro:include filename=".hidden/o.xacro"/>',
        '<link name="$(env HOME)"/>',
        "<link name=\"$(${{'env'}} HOME)\"/>",
        '<link name="$(optenv HOME x)"/>',
        '<link name="$(cwd)"/>',
    ],
)
def test_other_files_and_the_environment_are_not_read(wanted: str, tmp_path: Path) -> None:
    out, pkg = tmp_path / "outside", tmp_path / "pkg" / "urdf"
    out.mkdir()
    pkg.mkdir(parents=True)
    (tmp_path / "pkg" / "package.xml").write_text("<package><name>pkg</name></package>")
    (out / "o.xacro").write_text('<robot><link name="l"/></robot>')
    (out / "o.yaml").write_text("a: secret\n")
    (pkg / "link").symlink_to(out)
    (pkg / ".hidden").mkdir()
    (pkg / ".hidden" / "o.xacro").write_text('<robot><link name="l"/></robot>')
    text = wanted.format(out=out) + ("" if "link name" in wanted else '<link name="k"/>')
    (pkg / "r.xacro").write_text(f'<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">{text}</robot>')
    with pytest.raises(InputError):
        read_robot(pkg / "r.xacro")
    if "o.xacro" in wanted and "*" not in wanted and "find" not in wanted:  # the advice of the message works
        text = text.replace('<link name="k"/>', "")
        (pkg / "r.xacro").write_text(f'<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">{text}</robot>')
        assert read_standalone_description(pkg / "r.xacro", allow_external=True).urdf.links == ("l",)


def symbols() -> dict[str, object]:
    return build_symbols(
        load_yaml=lambda name: {"joint": {"max": 2.0, "rows": [1, 2, 3]}},
        absolute_name=lambda name: f"/folder/{name}",
        argument=lambda name: {"prefix": "left_"}[name],
        print_text=lambda text: None,
    )


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * 3 - 4 / 8", 6.5),
        ("radians(180)", math.pi),
        ("math.radians(-185)", math.radians(-185)),
        ("-pi/2", -math.pi / 2),
        ("0.5 * 0.23 * (3*0.05**2 + 0.1**2) / 12", 0.5 * 0.23 * (3 * 0.05**2 + 0.1**2) / 12),
        ("'a' + str(3)", "a3"),
        ("1 if 2 > 1 and not False else 0", 1),
        ("'x' in 'xyz' and 'q' not in ['a']", True),
        ("0 < 1 < 2", True),
        ("load_yaml('f')['joint']['max']", 2.0),
        ("xacro.load_yaml('f').joint.rows[-1]", 3),
        ("xacro.load_yaml('f')['joint'].get('none', 5)", 5),
        ("xacro.arg('prefix') + 'link'", "left_link"),
        ("xacro.abs_filename('a')", "/folder/a"),
        ("xacro.tokenize('a, b;c')", ["a", "b", "c"]),
        ("'A_b'.lower().replace('_', '-').split('-')", ["a", "b"]),
        ("[1, 2, 3][1:]", [2, 3]),
        ("{'a': 1}['a']", 1),
        ("sorted([3, 1, 2])", [1, 2, 3]),
        ("list(map(float, ['1', '2']))", [1.0, 2.0]),
        ("max(1, 2) + min([3, 4]) + len('abc')", 8),
        ("python.abs(-2) + python.sum([1, 2])", 5),
        ("'%.3f' % 1.23456", "1.235"),
        ("round(2.567, 1)", 2.6),
        ("int('12') + int(3.7) + float('0.5')", 15.5),
        ("7 // 2 + 7 % 4 + 2**10", 1030),
        ("sqrt(2) * sin(1) + atan2(1, 2) + hypot(3, 4)", math.sqrt(2) * math.sin(1) + math.atan2(1, 2) + 5),
        ("(1, 2)[0]", 1),
        (r"'a\d'", r"a\d"),
        ("None is None", True),
        ("bool('') == False", True),
        ("degrees(1) + tau - e + ceil(1.2) + floor(1.8) + fabs(-1)", math.degrees(1) + math.tau - math.e + 4),
    ],
)
def test_ordinary_expressions_have_the_value_of_python(text: str, value: object) -> None:
    found = evaluate_expression(text, symbols())
    assert type(found) is type(value)
    assert found == pytest.approx(value) if isinstance(value, float) else found == value


def test_work_of_a_file_is_bounded() -> None:
    budget = EvaluationBudget(left=1000)
    for _ in range(9):
        evaluate_expression("[1] * 100", symbols(), budget)
    with pytest.raises(XacroExpressionError):
        evaluate_expression("[1] * 100", symbols(), budget)
