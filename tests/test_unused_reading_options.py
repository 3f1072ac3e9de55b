"""Reading options over every kind of file: an effect, a refusal or a report, never silence."""

from __future__ import annotations

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
def test_an_option_acts_or_is_refused_or_reported(tmp_path: Path, sample: Sample, option: str) -> None:
    path = write(tmp_path, sample, sample.text)
    plain = read_toolpath(path, **sample.options)  # type: ignore[arg-type]
    asked = {**sample.options, **OPTIONS[option]}
    if find_file_kind(plain) not in APPLIES[option]:
        with pytest.raises(InputError) as refused:
            read_toolpath(path, **asked)  # type: ignore[arg-type]
        assert option in str(refused.value)
        return
    try:
        found = read_toolpath(path, **asked)  # type: ignore[arg-type]
    except InputError:
        return
    if sample is HSM and option == "--cycle-order":
        return  # RAPTO names its clearance, so both orders mean the same
    changed = not (found.position.shape == plain.position.shape and (found.position == plain.position).all())
    changed |= (
        not (found.axis == plain.axis).all() or not (found.feed[found.cutting] == plain.feed[plain.cutting]).all()
    )
    reported = any(w.startswith(option) for w in found.warnings)
    assert changed or reported or option in ("--decimals", "--offset", "--machine")  # G-code says itself what these do


def test_options_that_act_are_not_reported(tmp_path: Path) -> None:
    text = "UNITS/MM\nGOTO/5,5,20\nCYCLE/DRILL,2,12\nGOTO/5,5,1\nCYCLE/OFF\nFINI\n"
    path = tmp_path / "x.apt"
    path.write_text(text)
    t = read_toolpath(path, default_feed=0.01, cycle_order=("clear", "depth"))
    assert not [w for w in t.warnings if "no effect" in w]
    assert "options_used" not in t.meta
