"""Page and picture of a map: self-contained, exact numbers, reasons of empty positions."""

from __future__ import annotations

import base64
import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from machopt.cell.cell_reader import load_cell
from machopt.commands.map.run import MapRequest, run_map
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.kinematics.urdf_loading import load_robot
from machopt.report.charts.isolines import choose_round_levels, compute_isolines
from machopt.report.charts.map_charts import (
    ANGLE_LEVEL,
    build_curve_charts,
    build_field_spec,
    build_map_specs,
    pack_field_levels,
)
from machopt.report.page_types.map_sample_states import PlaceCode, convert_to_place_codes
from machopt.report.page_types.optimize_page_data import STATUS_NAMES
from machopt.report.page_types.workspace_map_page_data import (
    ArmLines,
    MapAxis,
    MapField,
    MapLayer,
    MapPageData,
    MeasuredView,
)
from machopt.report.pages.map_page import build_map_html, format_sample_location
from machopt.report.svg.chart_elements import VIRIDIS, build_image, compute_hatching, map_to_colours
from machopt.report.svg.map_picture import build_comparison_svg, build_map_svg
from machopt.workspace_map.document import REASON_TEXTS

KR240 = Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling"
ASSETS = Path(__file__).resolve().parents[1] / "machopt" / "report" / "assets"
VOID = {"meta", "br", "link", "img", "input"}
NAMES = tuple(REASON_TEXTS.get(c.reason, c.name.lower()) if c.reason is not None else "not checked" for c in PlaceCode)


class Balanced(HTMLParser):
    """Fail on a tag closed out of order and on external resources; collect ids, links and text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.anchors: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        given = dict(attrs)
        assert "src" not in given
        href = str(given.get("href", "#"))
        assert href.startswith(("#", "data:image/png;base64,"))
        if given.get("id"):
            self.ids.append(str(given["id"]))
        if tag == "a":
            self.anchors.append(href[1:])

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] not in (["script"], ["style"]):
            self.text += data


def read(html: str) -> Balanced:
    page = Balanced()
    page.feed(html)
    assert page.open == []
    assert len(set(page.ids)) == len(page.ids)
    assert set(page.anchors) <= set(page.ids)
    return page


def read_embedded_json(html: str) -> dict:  # type: ignore[type-arg]
    found = re.search(r'<script id=data type="application/json">(.*?)</script>', html, re.DOTALL)
    assert found is not None
    return json.loads(found[1])  # type: ignore[no-any-return]


def build_sample_map(kind: str = "slice", **changes: object) -> MapPageData:
    """A slice of 6 × 5 positions with a hole of each kind and two layers; or a volume, a line, a joint plane."""
    shape = {"slice": (6, 5), "volume": (6, 5, 4), "line": (7,), "joints": (6, 5)}[kind]
    names = {"slice": "xz", "volume": "xyz", "line": "s", "joints": ("a2", "a3")}[kind]
    unit = "rad" if kind == "joints" else "m"
    axes = tuple(MapAxis(n, f"{n} label", unit, np.linspace(0.1, 1.0, c)) for n, c in zip(names, shape, strict=True))
    M = int(np.prod(shape))
    rng = np.random.default_rng(0)

    def layer(name: str, title: str) -> MapLayer:
        reason = np.zeros(M, np.uint8)
        reason[:7] = (1, 2, 3, 4, 5, 6, 9) if kind != "line" else (0, 0, 1, 0, 0, 0, 0)
        q = np.where(reason[:, None] == 0, rng.uniform(-2, 2, (M, 6)), np.nan)
        k = np.where(reason == 0, rng.uniform(2e5, 9e5, M), np.nan)
        bend = np.where(reason == 0, rng.uniform(1e-4, 5e-3, M), np.nan)
        return MapLayer(
            name=name,
            title=title,
            value={"k_min": k, "k_x": 2 * k, "deflection": bend, "measured_x": 2.2 * k},
            reason=reason,
            q=q,
            gamma=np.where(reason == 0, 0.5, np.nan),
            shortfall=np.where(reason == 1, 0.123, 0.0),
            best=int(np.nanargmax(k)),
            guess={"measured_x": rng.random(M) < 0.5},
        )

    fields = (
        MapField(key="k_min", name="Stiffness, <softest> direction", unit="N/m", better="more", note="a note & more"),
        MapField(key="k_x", name="Stiffness along x", unit="N/m", better="more", note="along x"),
        MapField(key="deflection", name="Deflection under the load", unit="m", better="less", note="length"),
        MapField(
            key="measured_x", name="Measured k_x, interpolated", unit="N/m", better="more", note="IDW", model="k_x"
        ),
    )
    arm = ArmLines(
        joints=tuple("abcdef"),
        axis=np.tile([0.0, 0, 1], (6, 1)),
        point=np.arange(18.0).reshape(6, 3) / 10,
        base=np.zeros(3),
        up=np.array([0.0, 0, 1]),
        flange=np.ones(3),
        tcp=1.1 * np.ones(3),
    )
    observed = MeasuredView(
        file="m<.csv",
        axes=("x",),
        position=rng.random((4, 3)),
        measured=np.full((4, 1), 9e5),
        left_out=np.full((4, 1), 8e5),
        model=np.full((4, 1), 7e5),
        held_stiffness=np.full((4, 1), np.nan),
        errors={
            "x": {"left_out_rms": 0.1, "left_out_median": 0.05, "model_rms": 0.2, "model_median": 0.2, "held_rms": None}
        },
        from_joints=True,
        power=2.0,
    )
    data = MapPageData(
        title="Map of <a & b>",
        cell="a <b>",
        version="0",
        kind=kind,
        frame="base",
        place="Slice <y> = 0",  # type: ignore[arg-type]
        axes=axes,
        fixed=np.zeros(3),
        end=np.ones(3) if kind == "line" else None,
        fields=fields,
        layers=(layer("given", "rotation γ = 0°"), layer("free", "best rotation γ")),
        criterion="k_min",
        reasons=NAMES,
        arm=arm,
        verdict="half of it <can> be reached",
        warnings=("mind </script> & the gap",),
        measured=observed,
        options=(("by", "k_min"),),
        hashes=(("cell.yaml", "0" * 64),),
    )
    return replace(data, **changes)  # type: ignore[arg-type]


def decode_levels(spec: dict) -> np.ndarray:  # type: ignore[type-arg]
    """Decode packed levels as the page does."""
    raw = np.frombuffer(base64.b64decode(spec["level"]), "<u2")
    share = raw / 65534
    low, high = spec["low"], spec["high"]
    value = np.exp(np.log(low) + share * np.log(high / low)) if spec["log"] else low + share * (high - low)
    return np.where(raw == 65535, np.nan, value)


@pytest.mark.parametrize("kind", ["slice", "volume", "line", "joints"])
def test_every_kind_of_page_is_self_contained(kind: str) -> None:
    data = build_sample_map(kind)
    html = build_map_html(data)
    page = read(html)
    assert build_map_html(data) == html
    assert "half of it" in page.text.lower()
    assert "mind </script> & the gap" in page.text
    assert "<softest>" in page.text  # escaped, not a tag
    assert "http" not in re.sub(r'"http://www.w3.org/\d+/svg"', "", html)
    specs = read_embedded_json(html)
    assert (specs["field"] is None) == (kind == "line")
    assert bool(specs["charts"]) == (kind == "line")
    for chart in specs["charts"]:
        assert chart["id"] in page.ids
    assert ("arms" in page.ids) == (kind == "line")
    for word in ("Verdict", "Numbers", "What it means", "This run"):
        assert word in page.text
    if kind != "line":
        assert f"{REASON_TEXTS[InfeasibilityReason.COLLIDING]} {100 / data.layers[0].reason.size:.1f} %" in page.text


def test_page_without_reachable_samples_states_it_without_numbers(tmp_path: Path) -> None:
    outcome = run_map(MapRequest(cell=KR240, out=tmp_path / "m", at=9000.0, steps=("900",), length=600.0))
    html = (tmp_path / "m" / "report.html").read_text(encoding="utf-8")
    page = read(html)
    assert "OUT OF REACH" in page.text
    assert outcome.message[1:] in page.text
    assert "nan" not in page.text
    ET.fromstring((tmp_path / "m" / "map.svg").read_text(encoding="utf-8"))


def test_packed_levels_keep_four_digits_and_the_gaps() -> None:
    rng = np.random.default_rng(1)
    plain, wide = rng.uniform(3.0, 5.0, 500), 10 ** rng.uniform(0, 6, 500)
    plain[7] = wide[9] = np.nan
    for values, log in ((plain, False), (wide, True)):
        spec = pack_field_levels(values)
        assert spec["log"] is log
        # half a level: of the range, or of the logarithm of the range
        np.testing.assert_allclose(decode_levels(spec), values, rtol=0.6 * np.log(1e6) / 65534, equal_nan=True)
        known = values[np.isfinite(values)]
        assert (spec["from"], spec["to"]) == tuple(np.percentile(known, [2, 98]))
    assert pack_field_levels(np.full(3, np.nan))["level"] == ""
    assert np.unique(decode_levels(pack_field_levels(np.full(3, 7.0)))).tolist() == [7.0]
    json.dumps(pack_field_levels(np.full(3, np.nan)), allow_nan=False)


def test_page_codes_are_independent_of_reason_numbers() -> None:
    """The numbers of Reason may change; the patterns of the scripts and the words of both maps must not."""
    script = (ASSETS / "heatmap.js").read_text(encoding="utf-8")
    assert f"const NOT_CHECKED = {PlaceCode.NOT_CHECKED:d};" in script
    drawn = {int(n) for n in re.findall(r"^  (\d+): \(", script, re.MULTILINE)} | {int(PlaceCode.NOT_CHECKED)}
    assert drawn == set(range(1, len(STATUS_NAMES)))
    assert STATUS_NAMES[PlaceCode.LIMIT] == "joint limit"
    assert STATUS_NAMES[PlaceCode.SINGULAR_SHOULDER] == "shoulder singularity"
    assert STATUS_NAMES[PlaceCode.COLLIDING] == "collision"
    assert STATUS_NAMES[PlaceCode.NOT_CHECKED] == "not checked"
    reasons = np.array([c.reason for c in PlaceCode if c.reason is not None], np.uint8)
    assert [PlaceCode(c).reason for c in convert_to_place_codes(reasons).tolist()] == [
        InfeasibilityReason(r) for r in reasons.tolist()
    ]
    with pytest.raises(ValueError, match="no place of a map can be gouging"):
        convert_to_place_codes(np.array([InfeasibilityReason.OK, InfeasibilityReason.GOUGING], np.uint8))


def test_page_contains_joints_reasons_and_units_of_every_sample() -> None:
    data = build_sample_map()
    spec = build_field_spec(data)
    assert [a["unit"] for a in spec["axes"]] == ["mm", "mm"]
    np.testing.assert_allclose(spec["axes"][0]["values"], np.linspace(100, 1000, 6))
    for layer, message in zip(data.layers, spec["layers"], strict=True):
        status = np.frombuffer(base64.b64decode(message["status"]), np.uint8)
        np.testing.assert_array_equal(status, layer.reason)
        assert message["present"] == sorted(set(layer.reason.tolist()))
        assert max(message["present"]) < len(spec["names"])
        angle = np.frombuffer(base64.b64decode(message["q"]), "<i2").reshape(-1, 6)
        np.testing.assert_array_equal(angle[:, 0] == -32768, layer.reason != 0)
        ok = layer.reason == 0
        np.testing.assert_allclose(angle[ok] * ANGLE_LEVEL, np.degrees(layer.q[ok]), atol=ANGLE_LEVEL / 2 + 1e-9)
        np.testing.assert_allclose(
            decode_levels(message["value"]["k_min"])[ok], layer.value["k_min"][ok] * 1e-3, rtol=1e-4
        )
        np.testing.assert_allclose(
            decode_levels(message["value"]["deflection"])[ok], layer.value["deflection"][ok] * 1e3, rtol=1e-2, atol=1e-4
        )
        guess = np.frombuffer(base64.b64decode(message["value"]["measured_x"]["guess"]), np.uint8)
        np.testing.assert_array_equal(guess.astype(bool), layer.guess["measured_x"])
    script = (ASSETS / "field.js").read_text(encoding="utf-8")
    for key in (
        "level",
        "low",
        "high",
        "log",
        "from",
        "to",
        "guess",
        "status",
        "present",
        "best",
        "shortfall",
        "gamma",
    ):
        assert re.search(rf"\.{key}\b", script), key  # the script reads every written key


def test_stick_figure_data_agree_with_forward_kinematics() -> None:
    """Joint rotations applied one by one, as in the script of the page, give the TCP of forward kinematics."""
    cell = load_cell(KR240)
    robot = load_robot(cell)
    tcp = (robot.T_base_flange_zero @ cell.tool.T_flange_tcp)[:3, 3]
    q = np.random.default_rng(2).uniform(-2, 2, 6)
    p = tcp
    for i in range(5, -1, -1):
        axis, r = robot.axis[i], p - robot.point[i]
        c, s = np.cos(q[i]), np.sin(q[i])
        p = robot.point[i] + r * c + np.cross(axis, r) * s + axis * (axis @ r) * (1 - c)
    np.testing.assert_allclose(p, robot.compute_fk(q, cell.tool.T_flange_tcp)[:3, 3], atol=1e-12)


def test_curves_merge_equal_lines_and_keep_gaps() -> None:
    data = build_sample_map("line")
    for layer in data.layers:
        layer.value["k_axial"] = layer.value["k_x"].copy()
    more = (
        *data.fields,
        MapField(key="k_axial", name="Stiffness along the tool axis", unit="N/m", better="more", note=""),
    )
    charts = {c["id"]: c for c in build_curve_charts(replace(data, fields=more))}
    tip = charts["c-tip-given"]
    assert [s["name"] for s in tip["series"]] == [
        "Stiffness along x and along the tool axis",
        "Stiffness, <softest> direction",
    ]
    assert tip["series"][0]["y"][2] is None
    assert [s["name"] for s in charts["c-deflection"]["series"]] == ["rotation γ = 0°", "best rotation γ = 28.6°"]
    specs = build_map_specs(data)
    assert len(specs["arms"]["q"]) == 6
    assert len(specs["arms"]["line"]) == 2


def test_singular_peak_is_truncated_and_the_title_states_it() -> None:
    data = build_sample_map("line")
    for layer in data.layers:
        layer.value["held_x"] = np.array([1e6, 1e6, np.nan, 1e12, 2e6, 1e6, 1e6])
    fixed = replace(
        data, fields=(*data.fields, MapField(key="held_x", name="K_m xx", unit="N/m", better="more", note=""))
    )
    chart = next(c for c in build_curve_charts(fixed) if c["id"] == "c-held")
    assert chart["series"][0]["y"] == [1000.0, 1000.0, None, 10000.0, 2000.0, 1000.0, 1000.0]
    assert chart["title"].endswith("cut off at 10,000 N/mm")


def test_location_text_names_the_place_of_a_row() -> None:
    data = build_sample_map("volume")
    row = int(np.ravel_multi_index((2, 3, 1), data.shape))
    assert format_sample_location(data, row) == "x 460.0, y 775.0, z 400.0 mm"


@pytest.mark.parametrize("kind", ["slice", "volume", "line", "joints"])
def test_static_picture_is_one_self_contained_svg(kind: str) -> None:
    data = build_sample_map(kind)
    text = build_map_svg(data)
    assert build_map_svg(data) == text
    root = ET.fromstring(text)
    name = {"svg": "http://www.w3.org/2000/svg"}
    words = " ".join(t.text or "" for t in root.iter("{http://www.w3.org/2000/svg}text"))
    if kind == "line":
        assert "Stiffness along x" in words
        assert root.findall("svg:path", name)
        return
    images = root.findall("svg:image", name)
    present = set(np.concatenate([layer.reason for layer in data.layers]).tolist()) - {0}
    if kind == "volume":
        level = int(np.unravel_index(data.layers[0].best, data.shape)[2])
        assert f"shown at z = {data.axes[2].values[level] * 1e3:g} mm" in words
        present = {int(r) for x in data.layers for r in x.reason.reshape(data.shape)[..., level].ravel()} - {0}
    assert len(images) == 2 + len(present)  # two layers and a swatch for each reason
    for code in present:
        assert NAMES[code] in words
    assert base64.b64decode(images[0].get("href", "").split(",")[1]).startswith(b"\x89PNG")
    assert "label (deg)" in words if kind == "joints" else "label (mm)" in words


def test_model_and_measurement_share_their_colours() -> None:
    root = ET.fromstring(build_comparison_svg(build_sample_map(), "x"))
    words = [t.text for t in root.iter("{http://www.w3.org/2000/svg}text")]
    assert "Model" in words
    assert "Measured, interpolated" in words
    assert len(list(root.iter("{http://www.w3.org/2000/svg}image"))) == 2


def test_colours_run_from_dark_to_bright_and_hatchings_differ() -> None:
    np.testing.assert_array_equal(map_to_colours(np.array([0.0, 1.0])), VIRIDIS[[0, -1]])
    brightness = map_to_colours(np.linspace(0, 1, 50)).astype(float) @ [0.21, 0.72, 0.07]
    assert (np.diff(brightness) > 0).all()  # distinguishable in a greyscale print
    y, x = np.indices((36, 36))
    observed = {compute_hatching(code, x, y).tobytes() for code in (1, 2, 3, 4, 5, 6, 7)}
    assert len(observed) == 7


def test_isolines_of_a_plane_are_exact_and_stop_at_gaps() -> None:
    i, j = np.meshgrid(np.arange(8.0), np.arange(6.0), indexing="ij")
    (line,) = compute_isolines(2 * i + j, 7.3)
    np.testing.assert_allclose(2 * line[:, 0] + line[:, 1], 7.3, rtol=1e-12)
    assert len(line) == 8  # it crosses i = 2, 3 and j = 1 … 4: seven squares, eight sides
    assert ((line % 1 == 0).sum(axis=1) == 1).all()  # points are on the sides of the squares
    holed = 2 * i + j
    holed[2, 3] = np.nan
    away = compute_isolines(holed, 7.3)
    middles = np.concatenate([(p[1:] + p[:-1]) / 2 for p in away])
    assert 0 < len(middles) < len(line) - 1
    assert (np.abs(middles - [2, 3]).max(axis=-1) > 1).all()  # none inside the squares around the hole
    saddle = compute_isolines(np.array([[1.0, -1.0], [-1.0, 1.0]]), 0.1)
    assert len(saddle) == 2
    assert compute_isolines(np.zeros((3, 3)), 1.0) == []
    assert compute_isolines(np.zeros((1, 3)), 1.0) == []


def test_embedded_pixels_are_read_back_and_deterministic() -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    href = build_image((0, 0, 1, 1), pixels).attributes["href"]
    written = base64.b64decode(href.removeprefix("data:image/png;base64,"))
    with Image.open(BytesIO(written)) as read_back:
        np.testing.assert_array_equal(np.asarray(read_back), pixels)
    assert build_image((0, 0, 1, 1), pixels).attributes["href"] == href


def test_round_levels_are_round_and_inside() -> None:
    for low, high in ((0.013, 0.87), (-1234.0, 5678.0), (1e-9, 3e-9), (99.0, 101.0)):
        found = choose_round_levels(low, high)
        assert 3 <= len(found) <= 9
        assert found[0] >= low * (1 - 1e-9) - 1e-12
        assert found[-1] <= high * (1 + 1e-9)
        steps = np.diff(found)
        np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
        assert float(f"{steps[0]:.2g}") == pytest.approx(steps[0], rel=1e-6)
    assert choose_round_levels(1.0, 1.0).size == 0
