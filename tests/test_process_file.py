"""process.yaml: accepted content, and refusals with file and key."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from machopt.cell.process_file import load_process
from machopt.errors import InputError

MATERIALS = """
materials:
  al:
    milling: {Ktc: 767, Krc: 169, Kac: 222, Kte: 27.7, Kre: 26.6, Kae: 0.7, spread_percent: 25, source: paper}
    drilling: {kc1: 800, mc: 0.25, chisel_N_mm2: null, thrust_spread_percent: 60, torque_spread_percent: 25, source: t}
"""
DRILL = "{kind: drilling, spindle_rpm: 3000, layers: [{material: al, thickness_mm: 4}], depth_mm: 7, clamp_N: 900}"
MILL = "{kind: milling, material: al, spindle_rpm: 12000, ae_mm: 1, ap_mm: 6, cut: down}"


def write(folder: Path, operations: str, head: str = "machopt_process: 1", tail: str = "") -> Path:
    file = folder / "process.yaml"
    file.write_text(f"{head}{MATERIALS}operations:\n  {operations}\n{tail}")
    return file


def test_values_are_converted_to_si(tmp_path: Path) -> None:
    found = load_process(write(tmp_path, f"drill: {DRILL}", tail="modes: {damping_percent: [3, 4], source: hammer}"))
    one = found.operations[0]
    assert (one.label, one.kind, one.spindle_speed, one.depth, one.clamp) == ("drill", "drilling", 50.0, 0.007, 900.0)
    assert one.layers[0].thickness == 0.004
    assert found.quantile == 0.95
    assert found.materials["al"].milling is not None
    assert found.materials["al"].milling.Ktc_Pa == 767e6
    assert found.materials["al"].milling.Kte_N_m == 27.7e3
    assert found.materials["al"].drilling is not None
    assert found.materials["al"].drilling.thrust_sigma_log == pytest.approx(math.log(1.6))
    assert found.materials["al"].drilling.chisel_Pa is None
    assert found.damping is not None
    assert [found.damping.get_ratio(n) for n in range(3)] == [0.03, 0.04, None]


def test_missing_spreads_have_defaults(tmp_path: Path) -> None:
    file = write(tmp_path, f"drill: {DRILL}")
    file.write_text(file.read_text().replace("thrust_spread_percent: 60, ", ""))
    assert not load_process(file).materials["al"].has_drilling_spread
    assert load_process(file).materials["al"].has_milling_spread


@pytest.mark.parametrize(
    ("operations", "key"),
    [
        ("a: {kind: drilling, spindle_rpm: 3000, depth_mm: 7}", "operations.a"),  # no layers
        ("a: {kind: milling, material: al, ap_mm: 6, cut: down}", "operations.a"),  # no ae
        ("a: {kind: milling, material: al, ae_mm: 1, ap_mm: 6, cut: down, clamp_N: 3}", "operations.a"),
        ("a: {kind: milling, material: steel, ae_mm: 1, ap_mm: 6, cut: down}", "operations.a.material"),
        ("a: {kind: milling, material: al, engagement: stock}", "operations.a.engagement"),
        ("a: {kind: sawing}", "operations.a.kind"),
        ("a: {kind: force}", "operations.a"),
        ("a: {kind: force, force_N: {normal: 3}, wear: [2, 1]}", "operations.a"),
        ("a: {kind: force, force_N: {normal: 3}, points: [5, 2]}", "operations.a"),
        ("a: {kind: force, force_N: {normal: .nan}}", "operations.a.force_N.normal"),
        ("a: {kind: countersinking, material: al, depth_mm: 2, spindle_rpm: 900}", "operations.a"),
        (f"a: {MILL[:-1]}, colour: red}}", "operations.a.colour"),
        (f"a: {MILL[:-1]}, tolerance: {{surface_mm: -0.1}}}}", "operations.a.tolerance.surface_mm"),
    ],
)
def test_invalid_operations_are_refused_with_their_key(tmp_path: Path, operations: str, key: str) -> None:
    with pytest.raises(InputError) as caught:
        load_process(write(tmp_path, operations))
    assert caught.value.key == key or (caught.value.where or "").endswith(key), caught.value
    assert str(caught.value.file).endswith("process.yaml")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Krc: 169", "Krc: -169"),
        ("Krc: 169", "Krc: 900"),  # above Ktc: exchanged, or another convention
        ("Ktc: 767", "Ktc: 0"),
        ("kc1: 800", "kc1: -1"),
        ("mc: 0.25", "mc: 1.5"),
        ("source: paper", 'source: ""'),
        ("spread_percent: 25, source: paper", "source: paper, h_mm: [0.1, 0.02]"),
    ],
)
def test_invalid_coefficients_are_refused(tmp_path: Path, old: str, new: str) -> None:
    file = write(tmp_path, f"drill: {DRILL}")
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(InputError):
        load_process(file)


def test_unusual_coefficients_can_be_accepted(tmp_path: Path) -> None:
    file = write(tmp_path, f"drill: {DRILL}")
    file.write_text(file.read_text().replace("Krc: 169", "Krc: -169, accept: true", 1))
    assert load_process(file).materials["al"].accepts_unusual


@pytest.mark.parametrize("quantile", ["0.5", "1.0", "2"])
def test_quantile_must_be_between_half_and_one(tmp_path: Path, quantile: str) -> None:
    with pytest.raises(InputError):
        load_process(write(tmp_path, f"drill: {DRILL}", head=f"machopt_process: 1\nquantile: {quantile}"))
