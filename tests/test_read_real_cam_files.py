"""Real CAM exports from the team's local test data; skipped if absent (they may not be published)."""

from __future__ import annotations

import csv
import random
from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.toolpath_summary import summarise_toolpath

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "cam"
pytestmark = pytest.mark.skipif(not (DATA / "index.csv").exists(), reason="../shared/data/cam is not here")


def files() -> list[Path]:
    with (DATA / "index.csv").open(encoding="utf-8") as f:
        return [DATA / row["file"] for row in csv.DictReader(f)]


def readable(kind: str) -> list[Path]:
    return [f for f in files() if f.parent.name == kind]


@pytest.mark.parametrize("kind", ["camworks_apt", "camworks_clt", "catia_apt", "nx_clsf", "csv_path"])
def test_cl_data_is_read_completely(kind: str) -> None:
    for file in readable(kind):
        if "array_test" in file.name:
            continue  # one rapid point
        if "RotateThin" in file.name:
            with pytest.raises(InputError, match=r"line 466: .*cycle before it was not ended"):
                read_toolpath(file)
            continue
        unit = "mm" if "PDubovikov" in file.name else None
        t = read_toolpath(file, default_feed=0.01, unit=unit)
        assert [w.word for w in t.ignored if not w.understood] in ([], ["text after the end"]), file.name
        assert not any("tangents" in w for w in t.warnings), file.name
        summarise_toolpath(t)


@pytest.mark.parametrize("kind", ["apt_partprogram", "stepnc"])
def test_other_files_are_refused(kind: str) -> None:
    for file in readable(kind):
        with pytest.raises(InputError):
            read_toolpath(file, unit="mm", default_feed=0.01)


def test_camworks_and_the_heidenhain_program_posted_from_it_agree() -> None:
    """Two formats, two readers, one part with two set-ups: the points are equal within the arc tolerance.

    Drilling is omitted: the post writes its own pecks.
    """
    from scipy.spatial import cKDTree

    apt = read_toolpath(DATA / "camworks_apt/aamorim1913__wall-holes.apt")
    milling = np.array([o.kind == "trajectory" for o in apt.operations])[apt.operation] & apt.cutting
    for tilted, name in ((False, "aamorim1913__s_parts-tools_wall-holes__11.h"), (True, "aamorim1913__12.h")):
        h = read_toolpath(DATA / "heidenhain" / name)
        mine = milling & (np.abs(apt.axis[:, 0] + 1.0) < 1e-9 if tilted else apt.axis[:, 2] > 0.999)
        p = apt.position[mine] * 1e3
        if tilted:  # the set-up of the second program: X = -z, Y = -y, Z = -x
            p = -p[:, ::-1] + [-39.044, 12.433, -39.044]  # CYCL DEF 7 puts its zero at this point
        other = h.position[h.cutting & np.array([o.kind == "trajectory" for o in h.operations])[h.operation]] * 1e3
        assert cKDTree(p).query(other)[0].max() < 1e-3  # mm: three printed decimals
        assert cKDTree(other).query(p)[0].max() < 1e-3


def cut_points(toolpath: Toolpath, first: int, last: int) -> np.ndarray:  # type: ignore[type-arg]
    """Return the cut points (inch) of the blocks in lines first … last."""
    mine = (toolpath.line >= first) & (toolpath.line <= last) & toolpath.cutting
    return np.asarray(toolpath.position[mine] / 0.0254)


def test_three_controls_agree_on_one_tilted_facet() -> None:
    """One operation of one part, programmed with CYCLE800 of a Siemens control and with the axes of a Haas trunnion.

    The trunnion program has no tool-centre-point control, its zero is on the rotary axes, and its word B rotates the
    platter. Tolerance 2e-4 inch: four printed decimals of an inch and three of a degree.
    """
    siemens = read_toolpath(DATA / "sinumerik/Unigraphics__Cincinnati_Lamb_FTV5_840D_sample.ptp", unit="inch")
    trunnion = read_toolpath(DATA / "gcode_5axis/Unigraphics__Haas_5T.ptp", unit="inch", machine="table:B+Z,A-X@0,0,0")
    for by_plane, by_axes in (((364, 382), (380, 397)), ((390, 418), (400, 440))):
        a, b = cut_points(siemens, *by_plane), cut_points(trunnion, *by_axes)
        n = min(len(a), len(b), 12)
        assert n == 12
        assert np.abs(a[:n] - b[:n]).max() < 2e-4
    axis = [
        t.axis[(t.line > low) & (t.line < high) & t.cutting][0]
        for t, low, high in ((siemens, 363, 383), (trunnion, 379, 397))
    ]
    assert np.allclose(axis[0], axis[1], atol=1e-4)
    assert np.allclose(axis[0], [-0.43120, -0.43120, 0.79253], atol=1e-4)


def test_cycle_19_agrees_with_the_described_block() -> None:
    """BLK FORM states x -75 … 135, y -140 … 0, z -70 … 70; the face milled with A-90 is y = 0."""
    t = read_toolpath(DATA / "heidenhain/Unigraphics__training_deckel.h")
    face = t.cutting & (np.abs(t.axis[:, 1] - 1.0) < 1e-9) & (t.operation == 0)
    p = t.position[face] * 1e3
    assert np.allclose(p[:, 1], 0.0, atol=1e-9)
    assert p[:, 2].min() > -70.0
    assert p[:, 2].max() < 70.0


def test_din_iso_and_conversational_posts_of_one_job_drill_the_same_holes() -> None:
    iso = read_toolpath(DATA / "heidenhain/Unigraphics__Mikron_WF21D.ptp", default_feed=0.01)
    inch = read_toolpath(DATA / "gcode_3axis/Unigraphics__DMC_70V_sample_in.ptp", default_feed=0.01)
    holes = []
    for t in (iso, inch):
        drill = np.array([o.kind == "point" for o in t.operations])[t.operation] & t.cutting
        holes.append({tuple(np.round(p[:2] * 1e3, 1).tolist()) for p in t.position[drill]})
    assert holes[0] == holes[1]
    assert len(holes[0]) == 4


def test_every_file_is_read_or_refused_with_a_reason() -> None:
    """No file crashes a reader; a refusal has a reason of more than 12 characters."""
    read = 0
    for file in files():
        options: dict[str, object] = {}
        reason = ""
        for _ in range(4):
            try:
                t = read_toolpath(file, **options)  # type: ignore[arg-type]
            except InputError as error:
                reason = error.reason
                if "give it with --unit" in reason or "give the unit with --unit" in reason:
                    options["unit"] = "mm"
                elif "--feed" in reason:
                    options["default_feed"] = 0.01
                else:
                    break
            else:
                summarise_toolpath(t)
                read += 1
                reason = ""
                break
        assert reason == "" or len(reason) > 12, (file.name, reason)
    assert read >= 96  # of 150; the refused files lack data that a reader cannot know


def test_linuxcnc_impeller_plunges_along_its_tool_axis() -> None:
    file = DATA / "gcode_5axis/LinuxCNC__impeller-7bl-xyzac.ngc"
    t = read_toolpath(file, unit="mm", machine="table-ac-reversed")
    assert t.meta["plunges_along_axis"].startswith("14 with table-ac-reversed, 0 ")
    assert all("--decimals" in text for text in t.warnings)


def test_damaged_files_are_read_or_refused_without_a_crash(tmp_path: Path) -> None:
    rng = random.Random(7)
    small = [f for f in files() if f.stat().st_size < 8000]
    target = tmp_path / "damaged"
    refused = 0
    for _ in range(300):
        data = bytearray(rng.choice(small).read_bytes())
        if rng.random() < 0.4:
            del data[rng.randrange(len(data)) :]
        for _ in range(rng.randint(0, 6)):
            if data:
                data[rng.randrange(len(data))] = rng.choice(b"0123456789.,-+/$()[]#=\n XYZABCGMRIJKFN\xff")
        target.write_bytes(bytes(data))
        try:
            t = read_toolpath(target, unit=rng.choice([None, "mm"]), default_feed=0.01, machine="table-ac")
        except InputError:
            refused += 1
        else:
            assert np.isfinite(t.position).all()
            assert np.isfinite(t.axis).all()
            assert (t.feed[t.cutting] > 0.0).all()
    assert 0 < refused < 300
