"""``weights.stability``: fewer points beyond the stable depth of cut; consistent columns of points.csv."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.cli import main

ROOT = Path(__file__).resolve().parents[1]
PROCESS = """machopt_process: 1
materials:
  al: {milling: {Ktc: 767, Krc: 169, Kac: 222, Kte: 27.7, Kre: 26.6, Kae: 0.7, spread_percent: 25, source: paper}}
operations:
  default: {kind: milling, material: al, spindle_rpm: 12000, ae_mm: 1, ap_mm: 6, cut: down}
modes: {damping_percent: 3, source: assumed}
"""


def plan(folder: Path, name: str, weight: float) -> dict[str, list[str]]:
    from machopt.verification.tables.csv_columns import read_columns

    out = folder / name
    arguments = ["optimize", str(ROOT / "cells" / "kr500_milling"), str(folder / "part.csv"), "-o", str(out), "--quiet"]
    arguments += ["--process", str(folder / "process.yaml"), "--set", f"weights={{stability: {weight}}}"]
    assert main(arguments) == 0
    return read_columns(out / "points.csv")


def test_stability_weight_leaves_fewer_unstable_points(tmp_path: Path) -> None:
    lines = (ROOT / "toolpaths" / "contour_5axis.csv").read_text(encoding="utf-8").splitlines()
    head = next(n for n, line in enumerate(lines) if not line.startswith("#"))
    (tmp_path / "part.csv").write_text("\n".join([lines[head], *lines[head + 1 :: 12]]) + "\n", encoding="utf-8")
    (tmp_path / "process.yaml").write_text(PROCESS, encoding="utf-8")
    plain, priced = plan(tmp_path, "plain", 0.0), plan(tmp_path, "priced", 30.0)

    def count(table: dict[str, list[str]]) -> int:
        cuts = [word for word in table["chatter"] if word]
        assert len(cuts) > 150
        return sum(word != "stable" for word in cuts)

    assert count(priced) < 0.5 * count(plain)
    limits = np.array([float(v) if v else np.nan for v in priced["a_lim_mm"]])
    words = np.array(priced["chatter"])
    known = np.isfinite(limits)
    assert ((limits[known] > 6.0) == (words[known] == "stable")).all()
    assert all(float(v) > 1.0 for v in priced["f1_Hz"] if v)


def test_stability_is_unknown_without_damping(tmp_path: Path) -> None:
    lines = (ROOT / "toolpaths" / "contour_5axis.csv").read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if not line.startswith("#")][:40]
    (tmp_path / "part.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (tmp_path / "process.yaml").write_text(PROCESS.replace("modes:", "# modes:"), encoding="utf-8")
    table = plan(tmp_path, "out", 30.0)
    assert {word for word in table["chatter"] if word} == {"unknown"}
    assert not any(table["a_lim_mm"])


@pytest.mark.parametrize("ratio", [0.0, 0.6, 1.2, 5.0, np.inf])
def test_shortfall_is_zero_above_the_reserve(ratio: float) -> None:
    from machopt.planning.stability.stability_price import compute_shortfall

    assert compute_shortfall(np.array([ratio]))[0] == pytest.approx(max(0.0, 1.0 - ratio / 1.2))
