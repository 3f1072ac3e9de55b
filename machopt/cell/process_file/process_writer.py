"""process.yaml with what was measured: a material with the conditions of its cuts, or the damping of the modes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from machopt.data_types.cutting_coefficients import MillingCoefficients

_DIGITS = 6
_HEAD = (
    "# Coefficients from measured cuts. `default` repeats the measured cut: replace it by the operations of the job.\n"
)


@dataclass(frozen=True, kw_only=True)
class MeasuredCut:
    """Conditions of a measured cut."""

    spindle_speed: float  # rev/s
    spindle: str  # cw or ccw
    ae: float  # m
    ap: float  # m
    side: str  # up, down or slot


def write_process(path: Path, material: str, coefficients: MillingCoefficients, cut: MeasuredCut) -> None:
    """Write process.yaml.

    Args:
        path: Path of the file.
        material: Name of the material.
        coefficients: Milling coefficients.
        cut: A measured cut, for the operation ``default``.
    """
    from ruamel.yaml import YAML

    milling = {
        "Ktc": _round(coefficients.Ktc_Pa / 1e6),
        "Krc": _round(coefficients.Krc_Pa / 1e6),
        "Kac": _round(coefficients.Kac_Pa / 1e6),
        "Kte": _round(coefficients.Kte_N_m / 1e3),
        "Kre": _round(coefficients.Kre_N_m / 1e3),
        "Kae": _round(coefficients.Kae_N_m / 1e3),
        "spread_percent": _round(100.0 * math.expm1(coefficients.sigma_log)),
        "h_mm": [_round(1e3 * h) for h in coefficients.h_range_m],
        "source": coefficients.source,
    }
    operation: dict[str, Any] = {
        "kind": "milling",
        "material": material,
        "spindle_rpm": _round(60.0 * cut.spindle_speed),
        "spindle": cut.spindle,
        "ap_mm": _round(1e3 * cut.ap),
        "cut": cut.side,
    }
    if cut.side != "slot":
        operation["ae_mm"] = _round(1e3 * cut.ae)
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 120
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(_HEAD)
        yaml.dump(
            {
                "machopt_process": 1,
                "materials": {material: {"milling": milling}},
                "operations": {"default": operation},
            },
            file,
        )


def write_process_modes(path: Path, given: Path, damping_percent: list[float], source: str) -> None:
    """Write a process.yaml with other damping of the arm's modes; everything else is kept, comments too.

    Args:
        path: Path of the new file.
        given: process.yaml of the cell.
        damping_percent: Damping of the modes in ascending frequency.
        source: How it was measured.
    """
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.width = 4096
    data = yaml.load(given.read_text(encoding="utf-8"))
    data["modes"] = {"damping_percent": damping_percent, "source": source}
    with path.open("w", encoding="utf-8", newline="\n") as file:
        yaml.dump(data, file)


def _round(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
