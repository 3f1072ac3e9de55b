"""Real CAM exports of the team's local test data; skipped where they are absent (they are not ours to publish)."""

from __future__ import annotations

import csv
import random
from pathlib import Path

import numpy as np
import pytest

from machopt.errors import InputError
from machopt.formats.inspect import summarise
from machopt.formats.toolpath import read_toolpath

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "cam"
pytestmark = pytest.mark.skipif(not (DATA / "index.csv").exists(), reason="../shared/data/cam is not here")


def files() -> list[Path]:
    with (DATA / "index.csv").open(encoding="utf-8") as f:
        return [DATA / row["file"] for row in csv.DictReader(f)]


def readable(kind: str) -> list[Path]:
    return [f for f in files() if f.parent.name == kind]


@pytest.mark.parametrize("kind", ["camworks_apt", "camworks_clt", "catia_apt", "nx_clsf", "csv_path"])
def test_cl_data_is_read_whole(kind: str) -> None:
    for file in readable(kind):
        if "array_test" in file.name:
            continue  # one rapid point
        unit = "mm" if "PDubovikov" in file.name else None
        t = read_toolpath(file, default_feed=0.01, unit=unit)
        assert [w.word for w in t.ignored if not w.understood] in ([], ["text after the end"]), file.name
        assert not any("tangents" in w for w in t.warnings), file.name
        summarise(t)


@pytest.mark.parametrize("kind", ["apt_partprogram", "robot_kuka", "robot_abb", "robot_fanuc", "robot_ur", "stepnc"])
def test_what_is_no_toolpath_is_refused(kind: str) -> None:
    for file in readable(kind):
        with pytest.raises(InputError):
            read_toolpath(file, unit="mm", default_feed=0.01)


def test_camworks_and_the_heidenhain_program_posted_from_it_agree() -> None:
    """Two formats, two readers, one part with two set-ups: the same points within the arc tolerance.

    Drilling is left out: the post writes its own pecks.
    """
    from scipy.spatial import cKDTree

    apt = read_toolpath(DATA / "camworks_apt/aamorim1913__wall-holes.apt")
    milling = np.array([o.kind == "trajectory" for o in apt.operations])[apt.operation] & apt.cutting
    for tilted, name in ((False, "aamorim1913__s_parts-tools_wall-holes__11.h"), (True, "aamorim1913__12.h")):
        h = read_toolpath(DATA / "heidenhain" / name)
        mine = milling & (np.abs(apt.axis[:, 0] + 1.0) < 1e-9 if tilted else apt.axis[:, 2] > 0.999)
        p = apt.position[mine] * 1e3
        if tilted:  # the second program's set-up: X = -z, Y = -y, Z = -x
            p = -p[:, ::-1]
        other = h.position[h.cutting & np.array([o.kind == "trajectory" for o in h.operations])[h.operation]] * 1e3
        assert cKDTree(p).query(other)[0].max() < 1e-3  # mm: three printed decimals
        assert cKDTree(other).query(p)[0].max() < 1e-3


def test_linuxcnc_impeller_plunges_along_its_tool_axis() -> None:
    file = DATA / "gcode_5axis/LinuxCNC__impeller-7bl-xyzac.ngc"
    t = read_toolpath(file, unit="mm", machine="table-ac-reversed")
    assert t.meta["plunges_along_axis"].startswith("14 with table-ac-reversed, 0 ")
    assert t.warnings == ()


def test_damaged_files_are_read_or_refused_and_never_crash(tmp_path: Path) -> None:
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
