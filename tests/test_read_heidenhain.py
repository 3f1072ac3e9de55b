"""Heidenhain conversational and DIN/ISO programs beyond lines and circles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toolpath_file_samples import DIN_ISO

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.path_building.drilling_cycles import DrillingCycleError
from machopt.toolpath.readers.heidenhain.drilling_cycles import build_q_cycle
from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "BEGIN PGM A MM\nTOOL CALL 1 Z S1000\nL X+10 Y+0 Z+0 FMAX\n"
TAIL = "END PGM A MM\n"


def read(tmp_path: Path, text: str, name: str = "a.h", **options: object) -> Toolpath:
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, **options)  # type: ignore[arg-type]


def mm(toolpath: Toolpath) -> np.ndarray:  # type: ignore[type-arg]
    return np.round(toolpath.position * 1e3, 9)


def compute_turned_angle(p: np.ndarray, a: int = 0, b: int = 1) -> float:  # type: ignore[type-arg]
    angle = np.unwrap(np.arctan2(p[:, b], p[:, a]))
    return float(angle[-1] - angle[0])


def test_polar_lines_and_helices(tmp_path: Path) -> None:
    t = read(tmp_path, HEAD + "L Z+0 F100\nCC X+0 Y+0\nLP PR+20 PA+90\nCP IPA+720 Z-4 DR+\nCP PA+180 DR+\n" + TAIL)
    p = mm(t)
    assert np.allclose(p[2], [0.0, 20.0, 0.0], atol=1e-9)
    helix = p[2 : int(np.argmin(p[:, 2])) + 1]
    assert compute_turned_angle(helix) == pytest.approx(4.0 * np.pi)
    assert helix[-1].tolist() == [p[2, 0], p[2, 1], -4.0]
    assert np.allclose(p[-1], [-20.0, 0.0, -4.0], atol=1e-9)
    opposite = read(tmp_path, HEAD + "L Z+0 F100\nCC X+0 Y+0\nCP IPA+360 Z-2 DR-\n" + TAIL)
    assert compute_turned_angle(mm(opposite)[1:]) == pytest.approx(-2.0 * np.pi)
    assert any("opposite signs" in w for w in opposite.warnings)
    with pytest.raises(InputError, match="before a pole"):
        read(tmp_path, HEAD + "LP PR+5 PA+0 F100\n" + TAIL)


def test_circle_in_a_vertical_plane_and_a_pole_of_three_coordinates(tmp_path: Path) -> None:
    t = read(tmp_path, HEAD + "L Z+0 F100\nCC Y+5 Z+0\nC Y+5 Z+5 DR+\n" + TAIL)
    p = mm(t)[1:]
    assert np.allclose(p[:, 0], 10.0)
    assert np.allclose(np.hypot(p[:, 1] - 5.0, p[:, 2]), 5.0)
    assert compute_turned_angle(p - [0.0, 5.0, 0.0], 1, 2) == pytest.approx(
        -np.pi / 2 + 2 * np.pi
    )  # from -y to +z, DR+ about x
    with pytest.raises(InputError, match="its plane is not stated"):
        read(tmp_path, HEAD + "L Z+0 F100\nCC X+0 Y+0 Z+0\nC X-10 DR+\n" + TAIL)


@pytest.mark.parametrize(
    ("number", "words", "bottom", "feed"),
    [
        (201, {206: 50.0}, -9.0, 50.0),
        (203, {206: 50.0, 202: 3.0, 213: 2.0, 256: 0.5}, -9.0, 50.0),
        (207, {239: 1.5}, -9.0, 1500.0),
        (240, {206: 50.0, 343: 0.0}, -9.0, 50.0),
    ],
)
def test_cycles_by_their_q_parameters(number: int, words: dict[int, float], bottom: float, feed: float) -> None:
    plan = build_q_cycle(number, {200: 2.0, 201: -9.0, 203: 0.0, 204: 20.0, **words}, 1.0, 1000.0)
    assert (plan.bottom, plan.clear, plan.retract) == (bottom, 2.0, 20.0)
    assert plan.feed == feed
    assert plan.chip_break == (number == 203)


def test_cycles_without_a_depth_are_refused() -> None:
    with pytest.raises(DrillingCycleError, match="Q343=1"):
        build_q_cycle(240, {200: 2.0, 201: -9.0, 343: 1.0}, 1.0, 1.0)
    with pytest.raises(DrillingCycleError, match="without Q200"):
        build_q_cycle(200, {201: -9.0}, 1.0, 1.0)


def test_parameters_of_one_cycle_do_not_enter_the_next(tmp_path: Path) -> None:
    text = HEAD + "CYCL DEF 200 ~\nQ200=2 ~\nQ201=-5 ~\nQ206=50 ~\nQ202=2\nL X+0 M99 FMAX\nCYCL DEF 201 ~\nQ200=2\n"
    with pytest.raises(InputError, match="cycle 201 without Q200"):
        read(tmp_path, text + "L X+5 M99 FMAX\n" + TAIL)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("CYCL DEF 208 BORE MILLING\n", "cycle 208: only the drilling cycles"),
        ("CYCL DEF 8.0\nCYCL DEF 8.1 Z\n", "mirrors"),
        ("CYCL DEF 11.0\nCYCL DEF 11.1 SCL 0\n", "above zero"),
        ("CYCL DEF 7.0\nCYCL DEF 7.1 #5\n", "datum table"),
        ("RND R5\n", "without a contour element"),
        ("CT X+5 Y+5\n", "has no direction"),
        ("L X+1 M89 F5\n", "M89"),
        ("C X+1 Y+1\n", r"without DR\+"),
        ("L X+1 X+2 F5\n", "X is given twice"),
        ("LN X+1 TX+1 TY+0 TZ+0 F5\n", "outside of M128"),
        ("CYCL DEF 200\nQ200=2\nQ201=-9\nM128\nL B+30 FMAX\nL X+0 FMAX M99\n", "is not parallel to Z"),
    ],
)
def test_refusals(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, HEAD + "L Z+0 F100\n" + text + TAIL, machine="table-bc", default_feed=0.01)


def test_rotation_dwell_and_retract_along_the_tool(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        HEAD + "CYCL DEF 9.0 DWELL\nCYCLE DEF 9.1 DWELL 2\nCYCL DEF 10.0\nCYCL DEF 10.1 ROT+90\n"
        "L X+10 Y+0 Z+0 F100\nCYCL DEF 10.1 ROT+0\nL M140 MB 30\n" + TAIL,
    )
    assert np.allclose(mm(t)[1:], [[0, 10, 0], [0, 10, 30]])
    assert [(e.kind, e.value) for e in t.events if e.kind == "dwell"] == [("dwell", 2.0)]


def test_preset_change_is_another_zero(tmp_path: Path) -> None:
    text = HEAD + "CYCL DEF 247 ~\nQ339=+1\nL Z+0 F100\nCYCL DEF 247 ~\nQ339=+2\nL X+5\n" + TAIL
    with pytest.raises(InputError, match="from preset 1 to preset 2"):
        read(tmp_path, text)


def test_din_iso_and_conversational_agree(tmp_path: Path) -> None:
    iso = read(tmp_path, DIN_ISO.text, "a.i")
    conversational = read(
        tmp_path,
        "BEGIN PGM A MM\nTOOL CALL 1 Z S1000\nL X+10 Y+0 Z+50 FMAX M3\nL Z+0 F250\nCC X+0 Y+0\nC X-10 Y+0 DR+\n"
        "C X+0 Y+10 DR-\nLP PR+20 PA+45\nL IX+1\nL Z+50 FMAX\nCYCL DEF 200 ~\nQ200=2 ~\nQ201=-9 ~\nQ206=150 ~\n"
        "Q202=9 ~\nQ203=0 ~\nQ204=20\nL X+30 Y+30 FMAX M99\nCALL LBL 1\nM30\nLBL 1\nL X+40 F300\nLBL 0\nEND PGM A MM\n",
    )
    assert iso.format == "heidenhain-iso"
    assert np.allclose(iso.position, conversational.position, atol=1e-12)
    assert np.array_equal(iso.move, conversational.move)
    assert np.allclose(iso.feed, conversational.feed, equal_nan=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("N10 G24 R5 *\n", "chamfer"),
        ("N10 G28 Z *\n", "only X and Y are supported"),
        ("N10 G77 *\n", "G77 is not known"),
        ("N10 G02 X+5 Y+5 R1 *\n", "radius 1 is too small"),
        ("N10 G79 *\n", "before any drilling cycle"),
        ("N10 G01 X+5 F0 *\n", "feed 0"),
    ],
)
def test_din_iso_refusals(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, "%A G71 *\nN1 G00 G90 X+0 Y+0 Z+0 *\nN2 G01 Z-1 F100 *\n" + text + "N9999 %A G71 *\n", "a.i")


def test_spatial_angles_of_tcpm_need_no_machine(tmp_path: Path) -> None:
    """With AXIS SPAT, A, B and C rotate about the x, y and z of the coordinate system in turn, for any machine."""
    on = "FUNCTION TCPM F TCP AXIS SPAT PATHCTRL VECTOR REFPNT TIP-TIP\n"
    moves = "L X+0 Y+0 Z+0 A+30 F500\nL X+10 B+20\nL X+20 C+45\nL X+30\nL IA+10 X+40\n"
    t = read(tmp_path, HEAD + on + moves + "FUNCTION RESET TCPM\n" + TAIL)
    for row, (a, b, c) in zip(
        t.axis[1:], [(30, 0, 0), (30, 20, 0), (30, 20, 45), (30, 20, 45), (40, 20, 45)], strict=True
    ):
        np.testing.assert_allclose(
            row, Rotation.from_euler("xyz", [a, b, c], degrees=True).apply([0, 0, 1]), atol=1e-12
        )
    with pytest.raises(InputError, match="the tool axis depends on the machine"):
        read(tmp_path, HEAD + on.replace("SPAT", "POS") + moves + TAIL)
    with pytest.raises(InputError, match="turned or tilted coordinates"):
        read(tmp_path, HEAD + "CYCL DEF 10.0 ROTATION\nCYCL DEF 10.1 ROT+30\n" + on + moves + TAIL)
    with pytest.raises(InputError, match="the points are the tool's centre"):
        read(tmp_path, HEAD + on.replace("TIP-TIP", "CENTER-CENTER") + moves + TAIL)
