"""Reading options for every kind of file: an effect, a refusal or a report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from test_unknown_words import GENERIC, JBI, KRL, RAPID, SCRIPT, TP, VAL3, write
from toolpath_file_samples import (
    CAMWORKS,
    CATIA,
    CREO,
    DIN_ISO,
    FANUC,
    HEIDENHAIN,
    HSM,
    NCI,
    NX,
    SIEMENS,
    TABLE,
    Sample,
)

from machopt.cli import main
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.unused_reading_options import APPLIES, find_file_kind

APT_SAMPLES = (GENERIC, NX, CATIA, CREO, HSM, CAMWORKS)
SAMPLES = (*APT_SAMPLES, FANUC, SIEMENS, HEIDENHAIN, DIN_ISO, NCI, KRL, RAPID, TP, SCRIPT, JBI, VAL3, TABLE)
OPTIONS: dict[str, dict[str, object]] = {
    "--machine": {"machine": "table-ac"},
    "--offset": {"offsets": ("G59=1,2,3",)},
    "--decimals": {"decimals": 3},
    "--cycle-order": {"cycle_order": ("clear", "depth", "retract")},
    "--tool-axis": {"tool_axis": "+z"},
    "--kind": {"kind": "path"},
    "--feed": {"default_feed": 0.01},
    "--accept-unknown": {"accept_unknown": ("NOSUCHWORD",)},
}


@pytest.mark.parametrize("option", OPTIONS)
@pytest.mark.parametrize("sample", SAMPLES, ids=lambda s: s.name)
def test_option_has_an_effect_or_is_refused_or_reported(tmp_path: Path, sample: Sample, option: str) -> None:
    path = write(tmp_path, sample, sample.text)
    plain = read_toolpath(path, **sample.options)  # type: ignore[arg-type]
    requested = {**sample.options, **OPTIONS[option]}
    if find_file_kind(plain) not in APPLIES[option]:
        with pytest.raises(InputError) as refused:
            read_toolpath(path, **requested)  # type: ignore[arg-type]
        assert option in str(refused.value)
        return
    try:
        found = read_toolpath(path, **requested)  # type: ignore[arg-type]
    except InputError:
        return
    if sample is HSM and option == "--cycle-order":
        return  # RAPTO states its clearance, so both orders are equivalent
    changed = not (found.position.shape == plain.position.shape and (found.position == plain.position).all())
    changed |= (
        not (found.axis == plain.axis).all() or not (found.feed[found.cutting] == plain.feed[plain.cutting]).all()
    )
    reported = any(w.startswith(option) for w in found.warnings)
    # G-code readers report these themselves
    assert changed or reported or option in ("--decimals", "--offset", "--machine")


def test_options_with_effect_are_not_reported(tmp_path: Path) -> None:
    text = "UNITS/MM\nGOTO/5,5,20\nCYCLE/DRILL,2,12\nGOTO/5,5,1\nCYCLE/OFF\nFINI\n"
    path = tmp_path / "x.apt"
    path.write_text(text)
    t = read_toolpath(path, default_feed=0.01, cycle_order=("clear", "depth"))
    assert not [w for w in t.warnings if "no effect" in w]
    assert "options_used" not in t.meta


WORK_OFFSETS = "G21 G90 G17 G94 {}\nG0 X0. Y0. Z10.\nG1 Z-1. F200.\nX5.\n{}G0 Z10.\nM30\n"


@pytest.mark.parametrize(
    ("first", "more", "offsets"),
    [
        ("G54", "", ("G54=10,0,0",)),
        ("G54", "", ("G54=0,0,0",)),
        ("G55", "", ("G55=10,0,0",)),
        ("G54.1 P3", "", ("G54.1P3=1,0,0",)),
        ("G59.3", "", ("G59.3=1,0,0",)),
        ("G54", "G54\nX6.\n", ("G54=10,0,0",)),
        ("G54", "", ("G55=10,0,0",)),
        ("G54", "G54\nX6.\n", ("G54=10,0,0", "G56=1,1,1")),
        ("G54", "G55 X1. Y1. Z1.\n", ("G55=1,0,0", "G56=1,1,1")),
    ],
)
def test_offset_without_effect_is_refused(tmp_path: Path, first: str, more: str, offsets: tuple[str, ...]) -> None:
    file = tmp_path / "x.nc"
    file.write_text(WORK_OFFSETS.format(first, more))
    with pytest.raises(InputError, match="--offset"):
        read_toolpath(file, offsets=offsets)


def test_first_offset_applies_where_another_one_does(tmp_path: Path) -> None:
    file = tmp_path / "x.nc"
    file.write_text(WORK_OFFSETS.format("G54", "G55 X1. Y1. Z1.\n"))
    path = read_toolpath(file, offsets=("G54=10,0,0", "G55=15,0,0"))
    assert path.position[3, 0] * 1e3 == pytest.approx(6.0)


@pytest.mark.parametrize("decimals", [0, 3])
def test_decimals_option_for_numbers_with_points_is_refused(tmp_path: Path, decimals: int) -> None:
    file = tmp_path / "x.nc"
    file.write_text(WORK_OFFSETS.format("G54", ""))
    with pytest.raises(InputError, match="--decimals"):
        read_toolpath(file, decimals=decimals)


CELL = Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling"


@pytest.mark.parametrize(
    "words",
    [
        ["--unit", "mm"],
        ["--decimals", "3"],
        ["--decimals", "0"],
        ["--kind", "holes"],
        ["--strict"],
        ["--offset", "G55=1,0,0"],
        ["--feed", "100"],
        ["--machine", "table-ac"],
        ["--accept-unknown", "WORD"],
        ["--tool-axis=+z"],
        ["--max-extent", "100"],
        ["--cycle-order", "depth"],
        ["--cell", str(CELL)],
        ["--force"],
    ],
)
@pytest.mark.parametrize("file", [CELL, CELL / "cell.yaml"], ids=["folder", "file"])
def test_inspecting_a_cell_refuses_toolpath_options(
    file: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(file), *words]) == 2
    assert words[0].partition("=")[0] in capsys.readouterr().err


def test_cell_beside_a_toolpath_states_its_reach(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "x.nc"
    file.write_text(WORK_OFFSETS.format("", ""))
    assert main(["inspect", str(file), "--cell", str(CELL), "--json"]) == 0
    assert "reach" in json.loads(capsys.readouterr().out)["meta"]
