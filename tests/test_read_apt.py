"""APT and CL dialects, read from small snippets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from toolpath_file_samples import CREO, HSM

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.toolpath_summary import summarise_toolpath

NX_HEAD = """TOOL PATH/PROFILE,TOOL,END_MILL_10
TLDATA/MILL,10.0,0.0,75.0,0.0,0.0
MSYS/0.0,0.0,0.0,1.0,0.0,0.0,0.0,1.0,0.0
$$ centerline data
PAINT/COLOR,186
RAPID
GOTO/10.0,0.0,50.0,0.0,0.0,1.0
RAPID
GOTO/10.0,0.0,5.0
FEDRAT/MMPM,600.0
GOTO/10.0,0.0,0.0
"""
NX_TAIL = "END-OF-PATH\n"


def read(tmp_path: Path, text: str, name: str = "part.cls", **options: object) -> Toolpath:
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, **options)  # type: ignore[arg-type]


def mm(toolpath: Toolpath) -> np.ndarray:  # type: ignore[type-arg]
    return np.round(toolpath.position * 1e3, 9)  # the conversion to metres and back loses the last bits


def test_nx_rapid_applies_to_one_motion_and_the_feed_resumes(tmp_path: Path) -> None:
    t = read(tmp_path, NX_HEAD + "RAPID\nGOTO/10.0,0.0,5.0\nGOTO/10.0,0.0,-1.0\n" + NX_TAIL)
    assert t.format == "apt/nx"
    assert t.move.tolist() == [MoveKind.RAPID, MoveKind.RAPID, MoveKind.CUT, MoveKind.RAPID, MoveKind.CUT]
    assert t.feed[[2, 4]] == pytest.approx(0.01)  # 600 mm/min
    assert np.isnan(t.feed[[0, 1, 3]]).all()
    assert t.operations[0].label == "PROFILE"
    assert t.operations[0].tool == "END_MILL_10"
    assert t.operations[0].kind == "point"
    assert t.line.tolist() == [7, 9, 11, 13, 14]
    assert t.warnings == ()


@pytest.mark.parametrize(("k", "above"), [(-1.0, True), (1.0, False)])
def test_nx_circle_is_left_handed_about_its_axis(tmp_path: Path, k: float, above: bool) -> None:
    # from (10, 0) to (-10, 0) about the origin: with axis -z (left-handed) counter-clockwise, so over +y
    text = NX_HEAD + f"CIRCLE/0.0,0.0,0.0,0.0,0.0,{k},10.0,0.06,0.5,10.0,0.0\nGOTO/-10.0,0.0,0.0\n" + NX_TAIL
    p = mm(read(tmp_path, text))
    arc = p[3:]
    assert np.allclose(np.linalg.norm(arc[:, :2], axis=1), 10.0, atol=1e-9)
    assert (arc[:-1, 1] > 0.0).all() == above
    assert np.array_equal(p[-1], [-10.0, 0.0, 0.0])
    chord = np.linalg.norm(np.diff(np.vstack([p[2], arc]), axis=0), axis=1).max()
    assert 10.0 - np.sqrt(100.0 - chord**2 / 4.0) <= 0.005 + 1e-9  # sagitta within the 5 µm tolerance


def test_nx_helix_times_two_adds_one_turn(tmp_path: Path) -> None:
    text = NX_HEAD + "CIRCLE/0,0,-4,0,0,-1,10.0,0.06,0.5,10.0,0.0,TIMES,2\nGOTO/0.0,10.0,-4.0\n" + NX_TAIL
    p = mm(read(tmp_path, text))[2:]
    angle = np.unwrap(np.arctan2(p[:, 1], p[:, 0]))
    assert angle[-1] - angle[0] == pytest.approx(2.5 * np.pi)
    assert np.allclose(np.diff(p[:, 2]) / np.diff(angle), -4.0 / (2.5 * np.pi))


def test_nx_nurbs_starts_at_the_point_before_it(tmp_path: Path) -> None:
    # four control points on a line with equal steps are a straight line with uniform speed
    text = NX_HEAD + "NURBS/\nKNOT/1.0\nCNTRL/20,0,0\nCNTRL/30,0,0\nCNTRL/40,0,0\nGOTO/50,0,0\n" + NX_TAIL
    p = mm(read(tmp_path, text))
    assert np.allclose(p[3:], [[40.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    bent = NX_HEAD + "NURBS/\nKNOT/0.5,1.0\nCNTRL/20,5,0\nCNTRL/30,9,0\nCNTRL/40,0,0\nCNTRL/50,0,0\n" + NX_TAIL
    q = mm(read(tmp_path, bent))[2:]
    fine = mm(read(tmp_path, bent, arc_tolerance=1e-9))[2:]
    off = [_distance(f, q) for f in fine]
    assert len(q) > 8
    assert max(off) <= 5.0e-3  # mm: the requested tolerance


def _distance(point: np.ndarray, line: np.ndarray) -> float:  # type: ignore[type-arg]
    a, b = line[:-1], line[1:]
    s = np.clip(np.einsum("ij,ij->i", point - a, b - a) / np.einsum("ij,ij->i", b - a, b - a), 0.0, 1.0)
    return float(np.linalg.norm(a + s[:, None] * (b - a) - point, axis=1).min())


def test_nx_second_msys_is_transformed_into_the_first(tmp_path: Path) -> None:
    later = NX_HEAD.replace("MSYS/0.0,0.0,0.0,1.0,0.0,0.0,0.0,1.0,0.0", "MSYS/100.0,0,0,0,1.0,0,-1.0,0,0")
    t = read(tmp_path, NX_HEAD + NX_TAIL + later.replace("PROFILE", "SIDE") + NX_TAIL)
    assert np.allclose(mm(t)[5], [100.0, 10.0, 0.0])  # the x axis is along the previous y axis
    assert [o.label for o in t.operations] == ["PROFILE", "SIDE"]
    assert any("coordinate system changes" in w for w in t.warnings)


def test_nx_cycle_depth_is_signed_along_the_axis(tmp_path: Path) -> None:
    text = NX_HEAD.split("RAPID", maxsplit=1)[0] + (
        "CYCLE/DRILL,RAPTO,3.0,FEDTO,-12.0,MMPM,250.0\nGOTO/66.0,0.0,240.0,0.0,0.0,1.0\nGOTO/0.0,0.0,240.0\nCYCLE/OFF\n"
    )
    t = read(tmp_path, text + NX_TAIL)
    assert t.operations[0].kind == "point"
    assert mm(t)[t.cutting].tolist() == [[66.0, 0.0, 228.0], [0.0, 0.0, 228.0]]
    assert t.feed[t.cutting] == pytest.approx(250.0 / 60e3)
    assert [MoveKind(m).word for m in t.move] == ["rapid", "cut", "retract", "rapid", "cut", "retract"]


def test_arc_that_contradicts_its_neighbours_is_reported(tmp_path: Path) -> None:
    body = "GOTO/10.0,-5.0,0.0\nGOTO/10.0,0.0,0.0\nCIRCLE/0,0,0,0,0,{k},10.0\nGOTO/-10.0,0.0,0.0\nGOTO/-10.0,-5.0,0.0\n"
    good = read(tmp_path, NX_HEAD + body.format(k=-1) + NX_TAIL)
    bad = read(tmp_path, NX_HEAD + body.format(k=1) + NX_TAIL)
    assert not any("tangents" in w for w in good.warnings)
    assert any("tangents" in w and "line" in w for w in bad.warnings)


CATIA_HEAD = """$$ CATIA APT VERSION 1.0
$$*CATIA0
$$ Program.1
$$     1.00000     0.00000     0.00000     5.00000
$$     0.00000     1.00000     0.00000     0.00000
$$     0.00000     0.00000     1.00000    60.00000
PARTNO PART TO BE MACHINED
$$ OPERATION NAME : Contour.1
TLAXIS/ 0.000000, 0.000000, 1.000000
LOADTL/1
LOADTL/1,1
SPINDL/  2000.0000,RPM,CLW
RAPID
GOTO  /   10.00000,    0.00000,    1.00000
FEDRAT/    0.1000,MMPR
GOTO  /   10.00000,    0.00000,    0.00000
"""


def test_catia_arc_by_tangent_and_feed_per_revolution(tmp_path: Path) -> None:
    text = CATIA_HEAD + (
        "AUTOPS\nINDIRV/  0.00000,  1.00000,  0.00000\nTLON,GOFWD/ (CIRCLE/ 0.00000, 0.00000, 0.00000,$\n"
        "  10.00000),ON,(LINE/ 0.00000, 0.00000, 0.00000,$\n  -10.00000, 0.00000, 0.00000)\nFINI\n"
    )
    t = read(tmp_path, text, "part.aptsource")
    p = mm(t)
    assert t.format == "apt/catia"
    assert (p[2:-1, 1] > 0.0).all()
    assert np.allclose(p[-1], [-10.0, 0.0, 0.0])
    assert t.feed[t.cutting] == pytest.approx(0.1 * 2000.0 / 60e3)  # 0.1 mm per revolution at 2000 rpm
    assert "60" in t.meta["frame"]
    assert [e.kind for e in t.events].count("tool") == 1  # LOADTL/1,1 names the same tool again
    assert t.operations[0].label == "Contour.1"
    assert t.warnings == ()


def test_catia_full_circle_by_second_intersection(tmp_path: Path) -> None:
    text = CATIA_HEAD + ("INDIRV/0,-1,0\nTLON,GOFWD/(CIRCLE/0,0,0,10),ON,2,INTOF,(LINE/0,0,0,$\n10,0,0)\nFINI\n")
    p = mm(read(tmp_path, text, "part.txt"))[1:]
    angle = np.unwrap(np.arctan2(p[:, 1], p[:, 0]))
    assert angle[-1] - angle[0] == pytest.approx(-2.0 * np.pi)


CAMWORKS_HEAD = """PARTNO/1
UNIT/MM
INSERT/[HOLDER=X] 12MM MILL
CSI_SET_FLUTE_LENGTH/15.
LOAD/TOOL,15
SPINDL/1334,RPM,CLW
TRNTYP/WORLD,0,0,0
CSYS/1.,0,0,0,0,1.,0,0,0,0,1.,0
RAPID/
GOTO/10.,0,5.
FEDRAT/120.5,MMPM
GOTO/10.,0,0
"""


def test_camworks_circle_is_right_handed_and_closes(tmp_path: Path) -> None:
    text = CAMWORKS_HEAD + "CIRCLE/0,0,0,0,0,1.\nGOTO/-10.,0,0\nCIRCLE/0,0,0,0,0,-1.\nGOTO/-10.,0,0\nFINI\n"
    t = read(tmp_path, text, "part.apt")
    p = mm(t)
    half = int(np.argmin(np.abs(p[:, 0] + 10.0)))
    assert t.format == "apt/camworks"
    assert (p[2:half, 1] > 0.0).all()
    angle = np.unwrap(np.arctan2(p[half:, 1], p[half:, 0]))
    assert angle[-1] - angle[0] == pytest.approx(-2.0 * np.pi)  # start = end: a full circle, clockwise
    assert t.operations[0].label == "1 12MM MILL"
    assert t.operations[0].tool == "15"


def test_camworks_csys_rotates_the_tool_and_not_the_points(tmp_path: Path) -> None:
    text = (
        CAMWORKS_HEAD
        + "CSYS/0,0,-1.,0,-1.,0,0,0,0,1.,0,0\nRAPID/\nGOTO/-25.,101.,-47.,-1.,0,0\nGOTO/3.,101.,-47.\nFINI\n"
    )
    t = read(tmp_path, text, "part.apt")
    assert np.allclose(mm(t)[-1], [3.0, 101.0, -47.0])
    assert np.allclose(t.axis[-1], [-1.0, 0.0, 0.0])
    assert t.operations[1].kind == "point"


def test_camworks_pecking(tmp_path: Path) -> None:
    text = CAMWORKS_HEAD.split("RAPID/", maxsplit=1)[0] + (
        "RAPID/\nGOTO/8.,15.,25.\nCYCLE/INIT\n"
        "CYCLE/DEEP2,FEDTO,8.,1STPECK,5.,SUBPECK,2.,MMPM,300.,RAPTO,3.,RTRCTO,25.\nGOTO/8.,15.,0\nCYCLE/OFF\nFINI\n"
    )
    t = read(tmp_path, text, "part.apt")
    assert mm(t)[t.cutting, 2] == pytest.approx([-5.0, -7.0, -8.0])
    assert mm(t)[-1, 2] == pytest.approx(25.0)
    words = [MoveKind(m).word for m in t.move]
    assert words == ["rapid", "rapid", "cut", "retract", "approach", "cut", "retract", "approach", "cut", "retract"]
    assert np.isnan(t.feed[~t.cutting]).all()
    assert t.operations[0].kind == "point"


def test_inch_and_delta_and_movarc(tmp_path: Path) -> None:
    text = (
        "PARTNO TEST\nUNITS/INCHES\nMULTAX/ON\nFROM/0,0,2\nRAPID\nGOTO/1.0,0,1,0,0,1\nFEDRAT/10.0,IPM\n"
        "GODLTA/-1.0\nMOVARC/0,0,0,0,0,1,1.0,ANGLE,90\nGOTO/0,1.0,0,0,0.6,0.8\nFINI\n"
    )
    t = read(tmp_path, text, "hsm.apt")
    p = mm(t)
    assert p[1] == pytest.approx([25.4, 0.0, 25.4])
    assert p[2] == pytest.approx([25.4, 0.0, 0.0])
    assert p[-1] == pytest.approx([0.0, 25.4, 0.0])
    assert np.allclose(np.linalg.norm(p[2:, :2], axis=1), 25.4)
    assert t.axis[-1] == pytest.approx([0.0, 0.6, 0.8])
    assert t.feed[2] == pytest.approx(254.0 / 60e3)
    assert t.format == "apt"


def test_crlf_bom_and_latin1_read_the_same(tmp_path: Path) -> None:
    plain = read(tmp_path, NX_HEAD + NX_TAIL)
    file = tmp_path / "b.cls"
    file.write_bytes(b"\xef\xbb\xbf" + (NX_HEAD + NX_TAIL).replace("\n", "\r\n").encode())
    assert np.array_equal(read_toolpath(file).position, plain.position)
    file.write_bytes((NX_HEAD + "PPRINT/Fr\xe4sen\n" + NX_TAIL).encode("latin-1"))
    t = read_toolpath(file)
    assert np.array_equal(t.position, plain.position)
    assert t.events[-1].text == "Fr\xe4sen"


def test_unknown_words_are_counted_and_refused_by_strict(tmp_path: Path) -> None:
    text = NX_HEAD + "FOOBAR/1,2\nCOOLNT/ON\nFOOBAR/3\n" + NX_TAIL
    t = read(tmp_path, text)
    (word,) = [w for w in t.ignored if not w.understood]
    assert (word.word, word.count, word.first_line) == ("FOOBAR", 2, 12)
    assert any(w.word == "PAINT" and w.understood for w in t.ignored)
    assert [e.kind for e in t.events] == ["coolant"]
    with pytest.raises(InputError, match=r"line 12: word 'FOOBAR'"):
        read(tmp_path, text, strict=True)


def test_truncated_files_are_reported(tmp_path: Path) -> None:
    t = read(tmp_path, NX_HEAD)
    assert t.warnings[0].startswith("INCOMPLETE FILE? no FINI")
    u = read(tmp_path, NX_HEAD + "GOTO/1.0,2.")
    assert len(u) == len(t)
    assert u.warnings[0].startswith("INCOMPLETE FILE? line 12: the last line is cut off")
    assert u.meta["incomplete"]
    with pytest.raises(InputError, match="seems incomplete, and strict reading was requested: no FINI"):
        read(tmp_path, NX_HEAD, strict=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("PARTNO/1\nUNITS/MM\nGOTO/1,2,3\nFINI\n", "--feed"),
        ("PARTNO/1\nGOTO/1,2,3\nFINI\n", "--unit"),
        ("UNITS/MM\nFEDRAT/100\nGOTO/1,nan,3\nFINI\n", "line 3.*not finite"),
        ("UNITS/MM\nFEDRAT/100\nGOTO/1,2\nFINI\n", "line 3.*2 numbers"),
        ("UNITS/MM\nFEDRAT/100\nGOTO/1,2,3,0,0,0\nFINI\n", "line 3.*axis is zero"),
        ("UNITS/MM\nFEDRAT/100\nGOTO/1,2,3e7\nFINI\n", "line 3.*1e\\+06"),
        ("UNITS/MM\nRAPID\nGOTO/1,2,3\nFINI\n", "no cutting move"),
        ("UNITS/MM\nFEDRAT/100,MMPR\nGOTO/1,2,3\nFINI\n", "--feed"),
        ("UNITS/MM\nFEDRAT/INVERS,10\nGOTO/1,2,3\nFINI\n", "line 2.*INVERS is no speed"),
        (
            "UNITS/MM\nFEDRAT/100\nGOTO/1,2,3\nCIRCLE/0,0,0,0,0,1\nGOTO/900,2,3\nFINI\n",
            "line 5.*distance from the centre",
        ),
        ("UNITS/MM\nFEDRAT/100\nGOTO/1,2,3\nCYCLE81/1,2\nFINI\n", "line 4.*CYCLE81"),
        ("UNITS/MM\nFEDRAT/100\nGOTO/1,2,3\nTRACUT/M1\nFINI\n", "line 4.*TRACUT"),
        ("UNITS/MM\nSET/MODE,INCR\nFEDRAT/100\nGOTO/1,2,3\nFINI\n", "line 2.*--accept-unknown"),
        ("UNITS/MM\nFEDRAT/100\nGOTO/1,2,3\nMIRROR/YZPLAN\nFINI\n", "line 4.*MIRROR"),
        ("partno x\nclprnt\npl1=plane/0,0,1,4\ngoto/1,2,3\nfini\n", "part program"),
    ],
)
def test_refusals_name_the_place_and_the_remedy(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, text, "x.apt")
    assert "x.apt" in str(caught.value)


def test_unit_and_feed_options(tmp_path: Path) -> None:
    text = "PARTNO/1\nGOTO/1,2,3\nFINI\n"
    t = read(tmp_path, text, "x.apt", unit="inch", default_feed=0.02)
    assert mm(t)[0] == pytest.approx([25.4, 50.8, 76.2])
    assert t.feed[0] == pytest.approx(0.02)
    with pytest.raises(InputError, match="--unit inch"):
        read(tmp_path, NX_HEAD + NX_TAIL, unit="inch")


def test_summary_is_json(tmp_path: Path) -> None:
    import json

    summary = summarise_toolpath(read(tmp_path, NX_HEAD + NX_TAIL)).to_json_types()
    assert json.loads(json.dumps(summary)) == summary
    assert summary["points"] == 3
    assert summary["moves"] == {"cut": 1, "rapid": 2, "approach": 0, "retract": 0, "link": 0}
    assert summary["length_mm"]["cut"] == 5.0


def test_catia_five_axes_and_turning_is_reported(tmp_path: Path) -> None:
    text = CATIA_HEAD.replace("LOADTL/1\n", "TOOLNO/1,TURN,1\nMULTAX\n") + (
        "GOTO  /   20.00000,    0.00000,    0.00000,$\n  0.60000, 0.00000, 0.80000\nFINI\n"
    )
    t = read(tmp_path, text, "part.txt")
    assert t.axis[-1] == pytest.approx([0.6, 0.0, 0.8])
    assert any("turning" in w for w in t.warnings)


def test_clt_follows_the_axis_and_one_table_position(tmp_path: Path) -> None:
    text = (
        "UNITS/ MM \nTLAXIS/ 0,-1,0 \nOPFEATSTART/Mill1\nROTABL/ 1.570796,AAXIS,TABLE,CCLW \nRAPID/ \n"
        "GOTO/ 10,0,5 \nFEDRAT/ MMPM,300\nGOTO/ 10,0,0\n"
        "CIRCLE/ 0,0,0,0,0,1,10.0,CLOCKWISE \nGOTO/ 0,-10,0 \n"
        "CYCLE/ DRILL,G98,6.0,PECKING,5.0,2.0,MMPM,110,3.0,25.0 25.0 DWELL,0 \nGOTO/ 1,2,0 \nCYCLE/ OFF \nFINI \n"
    )
    t = read(tmp_path, text, "part.clt")
    p = mm(t)
    arc = p[1 : int(np.flatnonzero(np.abs(p[:, 1] + 10.0) < 1e-9)[0]) + 1]
    turned = np.unwrap(np.arctan2(arc[:, 1], arc[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(1.5 * np.pi)  # the word CLOCKWISE is wrong above 180°
    assert np.allclose(t.axis, [0.0, 0.0, 1.0])
    assert p[t.cutting][-2:, 2].tolist() == [-5.0, -6.0]
    with pytest.raises(InputError, match="table has another position"):
        read(
            tmp_path, text.replace("FINI", "ROTABL/ -1.570796,AAXIS\nRAPID/\nGOTO/1,1,9\nGOTO/1,1,1\nFINI"), "part.clt"
        )


@pytest.mark.parametrize(
    "cycle",
    [
        "DRILL,12.0,2.0",
        "DRILL,DEPTH,12,MMPM,300,CLEAR,2,RETURN,20",
        "DRILL,12,MMPM,300,2",
        "DRILL,FEDTO,12,RAPTO,2,DWELL,1",
    ],
)
def test_cycle_forms_of_catia_icam_and_hsm(tmp_path: Path, cycle: str) -> None:
    text = f"UNITS/MM\nFEDRAT/300,MMPM\nRAPID\nGOTO/5,5,20\nCYCLE/{cycle}\nGOTO/5,5,1\nCYCLE/OFF\nFINI\n"
    t = read(tmp_path, text, "x.apt")
    assert mm(t)[t.cutting].tolist() == [[5.0, 5.0, -11.0]]
    assert t.feed[t.cutting] == pytest.approx(0.005)
    assert mm(t)[1].tolist() == [5.0, 5.0, 3.0]
    assert mm(t)[-1, 2] == (21.0 if "RETURN" in cycle else 3.0)


# ---- Creo, HSM/Fusion, options


def test_creo_arc_through_several_points_and_csys_over_lines(tmp_path: Path) -> None:
    t = read(tmp_path, CREO.text, CREO.name)
    p = mm(t)
    arc = p[2 : int(np.argmin(p[:, 0])) + 1]
    assert t.format == "apt/creo"
    assert (arc[:-1, 1] > 0.0).all()  # right-handed about +z
    assert np.array_equal(arc[-1], [-10.0, 0.0, 0.0])  # only the last of the three points is its end point
    assert np.allclose(np.linalg.norm(arc[:, :2], axis=1), 10.0)
    assert p[t.cutting][-1].tolist() == [30.0, 0.0, -12.0]
    assert t.feed[t.cutting][-1] == pytest.approx(100.0 / 60e3)
    assert t.warnings == ()
    wrong = CREO.text.replace("0.0000000000, 0.0000000000, 1.0000000000, 10.0", "0.0000000000, 0.0, -1.0, 10.0")
    assert any("off it: check its direction" in w for w in read(tmp_path, wrong, CREO.name).warnings)


def test_creo_goto_under_multax_keeps_its_axis(tmp_path: Path) -> None:
    text = CREO.text.replace("FEDRAT / 300.0", "MULTAX / ON\nFEDRAT / 300.0").replace(
        "GOTO / 10.0000000000, 0.0000000000, 0.0000000000\n", "GOTO / 10.0, 0.0, 0.0, 0.0, 0.6, 0.8\n", 1
    )
    text = text[: text.index("CIRCLE")] + "FINI\n"
    t = read(tmp_path, text, CREO.name)
    assert t.axis[-1] == pytest.approx([0.0, 0.6, 0.8])
    assert len(t) == 2


def test_hsm_names_the_bottom_of_a_hole_and_swaps_the_spindle(tmp_path: Path) -> None:
    t = read(tmp_path, HSM.text, HSM.name)
    p = mm(t)
    assert t.format == "apt/hsm"
    assert [(o.label, o.tool, o.kind) for o in t.operations] == [("Drill1", "3", "point"), ("Swarf", "4", "trajectory")]
    drill = p[t.operation == 0]
    assert drill[:, 2].tolist() == [15.0, 5.0, -10.0, 15.0]  # clearance 15, rapid down to 15 − 10, bottom −10
    assert t.feed[2] == pytest.approx(200.0 / 60e3)
    assert t.axis[-1] == pytest.approx([0.0, 0.6, 0.8])
    assert next(e for e in reversed(t.events) if e.kind == "spindle").value == 0.0  # SPINDL/ON switches the spindle off
    high = HSM.text.replace("15.000000, RAPTO", "4.000000, RAPTO")
    with pytest.raises(InputError, match="with GOTO as the hole's bottom"):
        read(tmp_path, high, HSM.name)


def test_units_may_change_from_section_to_section(tmp_path: Path) -> None:
    text = HSM.text.replace("PPRINT/'Swarf'\n", "UNITS/INCHES\nPPRINT/'Swarf'\n").replace(
        "FEDRAT/500.000000, MMPM", "FEDRAT/20.0, IPM"
    )
    t = read(tmp_path, text, HSM.name)
    assert mm(t)[t.operation == 1][0] == pytest.approx([254.0, 0.0, 508.0])
    assert t.feed[-1] == pytest.approx(20.0 * 25.4 / 60e3)
    assert any("unit changes" in w for w in t.warnings)


def test_increments_are_asked_for_and_godlta_is_read(tmp_path: Path) -> None:
    text = "UNITS/MM\nTRANS/0,0,0\nFEDRAT/100\nGOTO/1,2,3\nSET/MODE,INCR\nGOTO/1,0,0\nSET/MODE,ABSOL\nGOTO/9,9,9\n"
    text += "GODLTA/-2\nGODLTA/1,0,0\nFINI\n"
    with pytest.raises(InputError) as refused:
        read(tmp_path, text, "x.apt")
    assert refused.value.where == "line 5"
    assert "--accept-unknown" in refused.value.reason
    t = read(tmp_path, text, "x.apt", accept_unknown=("set/mode,incr",))
    assert mm(t).tolist() == [[1, 2, 3], [1, 0, 0], [9, 9, 9], [9, 9, 7], [10, 9, 7]]


def test_order_of_numbers_in_cycle_is_an_option(tmp_path: Path) -> None:
    text = "UNITS/MM\nFEDRAT/300,MMPM\nRAPID\nGOTO/5,5,20\nCYCLE/DRILL,2,12,80\nGOTO/5,5,1\nCYCLE/OFF\nFINI\n"
    t = read(tmp_path, text, "x.apt", cycle_order=("clear", "depth", "feed"))
    assert mm(t)[t.cutting].tolist() == [[5.0, 5.0, -11.0]]
    assert t.feed[t.cutting] == pytest.approx(80.0 / 60e3)
    with pytest.raises(InputError, match="--cycle"):
        read(tmp_path, text, "x.apt", cycle_order=("deep",))


def test_fast_and_slow_line_readers_agree(tmp_path: Path) -> None:
    rows = [f"{x * 0.5:.3f},{x * x * 0.01:.4f},-1.5,0.0,0.6,0.8" for x in range(50)]
    head, tail = "UNITS/MM\nFEDRAT/100\n", "\nFINI\n"
    plain = read(tmp_path, head + "\n".join(f"GOTO/{r}" for r in rows) + tail, "x.apt")
    slow = read(tmp_path, head + "\n".join(f"  GOTO / {r.replace(',', ', ')} $$ x" for r in rows) + tail, "x.apt")
    assert np.array_equal(plain.position, slow.position)
    assert np.array_equal(plain.axis, slow.axis)
    assert np.array_equal(plain.line, slow.line)
