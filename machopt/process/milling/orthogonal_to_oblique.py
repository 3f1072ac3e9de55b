"""Milling coefficients from orthogonal cutting data: the oblique transformation.

Source: Budak, Altıntaş & Armarego, J. Eng. Ind. 118 (1996) 216; Altıntaş, Manufacturing Automation, 2nd ed. (2012),
section 2.5, with Stabler's rule that the chip flow angle equals the helix angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.errors import CuttingInputError


@dataclass(frozen=True, kw_only=True)
class OrthogonalCuttingData:
    """Orthogonal data of a work material; the rake angle α enters all laws in degrees, as they were fitted.

    Friction angle (degrees) = friction[0] + friction[1] α; chip ratio r = C0 h^C1 with h in mm, C0 = ratio[0] +
    ratio[1] α, C1 = exponent[0] + exponent[1] α.
    """

    shear_stress: float  # Pa
    friction: tuple[float, float]  # degrees, degrees per degree
    ratio: tuple[float, float]  # 1, 1 per degree
    exponent: tuple[float, float]  # 1, 1 per degree
    Kte_N_m: float
    Kre_N_m: float
    source: str


TI6AL4V = OrthogonalCuttingData(
    shear_stress=613e6,
    friction=(19.1, 0.29),
    ratio=(1.755, -0.028),
    exponent=(0.331, -0.0082),
    Kte_N_m=24e3,
    Kre_N_m=43e3,
    source="Budak, Altintas, Armarego 1996, Ti6Al4V",
)


def compute_oblique_coefficients(
    data: OrthogonalCuttingData, rake: float, helix: float, chip_thickness: float, sigma_log: float
) -> MillingCoefficients:
    """Return milling coefficients at one chip thickness.

    Args:
        data: orthogonal data of the material.
        rake: rad, normal rake angle.
        helix: rad, helix angle; its hand does not count.
        chip_thickness: m; the coefficients hold near it: the stated range is half to twice of it.
        sigma_log: spread of the result, standard deviation of the logarithm.

    Raises:
        CuttingInputError: an angle or chip thickness for which the laws give no shear plane.
    """
    if not 0.0 < chip_thickness < math.inf:
        raise CuttingInputError("the chip thickness must be larger than 0", key="h_mm")
    i = abs(helix)
    if not i < math.pi / 2:
        raise CuttingInputError("the helix angle must lie between −90° and 90°", key="helix_deg")
    degrees = math.degrees(rake)
    ratio = (data.ratio[0] + data.ratio[1] * degrees) * (chip_thickness * 1e3) ** (
        data.exponent[0] + data.exponent[1] * degrees
    )
    run = 1.0 - ratio * math.sin(rake)
    if not (ratio > 0.0 and run > 0.0 and abs(rake) < math.pi / 2):
        raise CuttingInputError(
            f"rake {degrees:g}° and chip thickness {chip_thickness * 1e3:g} mm are outside of the material's data",
            key="rake_deg",
        )
    shear = math.atan(ratio * math.cos(rake) / run)  # normal shear angle
    eta = i
    friction = math.atan(math.tan(math.radians(data.friction[0] + data.friction[1] * degrees)) * math.cos(eta))
    side = math.tan(eta) * math.sin(friction)
    root = math.hypot(math.cos(shear + friction - rake), side)
    stress = data.shear_stress / (math.sin(shear) * root)
    return MillingCoefficients(
        Ktc_Pa=stress * (math.cos(friction - rake) + math.tan(i) * side),
        Krc_Pa=stress * math.sin(friction - rake) / math.cos(i),
        Kac_Pa=stress * (math.cos(friction - rake) * math.tan(i) - side),
        Kte_N_m=data.Kte_N_m,
        Kre_N_m=data.Kre_N_m,
        Kae_N_m=0.0,
        h_range_m=(0.5 * chip_thickness, 2.0 * chip_thickness),
        sigma_log=sigma_log,
        source=f"{data.source}; oblique transformation at rake {degrees:g}°, helix {math.degrees(i):g}°, "
        f"chip thickness {chip_thickness * 1e3:g} mm",
    )
