"""The shipped table of cutting coefficients: values, ranges, sources, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from machopt.errors import CuttingInputError
from machopt.process.drilling.drilling_tools import DrillingTool
from machopt.process.drilling.thrust_and_torque import compute_full_load
from machopt.process.materials import (
    find_drilling_coefficients,
    find_milling_coefficients,
    list_drilling_materials,
    list_milling_materials,
)

WITHOUT_EXPONENT = {"vdi 38", "vdi 39", "vdi 40", "vdi 41"}


@pytest.mark.parametrize(
    ("group", "torque", "thrust"), [("vdi 6", 10.65, 2002), ("VDI 1", 7.64, 1436), ("Al7075", 4.90, 920)]
)
def test_published_holes_from_the_table(group: str, torque: float, thrust: float) -> None:
    load = compute_full_load(
        find_drilling_coefficients(group), DrillingTool(diameter=0.01, half_point_angle=math.radians(70)), 0.3e-3
    )
    assert load.torque[0] == pytest.approx(torque, rel=1e-3)
    assert load.thrust[0] == pytest.approx(thrust, rel=1e-3)


def test_every_material_has_coefficients_source_and_spread() -> None:
    for name in list_drilling_materials():
        if name in WITHOUT_EXPONENT:
            with pytest.raises(CuttingInputError, match="no exponent mc"):
                find_drilling_coefficients(name)
            continue
        found = find_drilling_coefficients(name)
        assert 500e6 < found.kc1_Pa < 5000e6
        assert 0.2 <= found.mc <= 0.3
        assert found.chisel_Pa is None
        assert found.thrust_sigma_log == pytest.approx(math.log(1.6))
        assert math.log(1.25) <= found.torque_sigma_log <= math.log(1.401)
        assert "VDI 3323" in found.source
    assert "2022" in find_drilling_coefficients("ti6al4v").source  # two editions differ by a factor of 1.6


def test_alloy_without_own_set_uses_the_mean_of_its_sets() -> None:
    names = list_milling_materials()
    assert {"al7075", "al7075-t6-a", "al6082-t6"} <= set(names)
    sets = [find_milling_coefficients(n) for n in ("al7075-t6-a", "al7075-c", "al7075-d")]
    alloy = find_milling_coefficients("AL 7075")
    mean = np.exp(np.mean(np.log([s.Kac_Pa for s in sets])))
    assert alloy.Kac_Pa == pytest.approx(mean)
    assert "geometric mean" in alloy.source
    assert "600 to 1319" in alloy.source
    assert alloy.sigma_log == pytest.approx(math.log(1.5))
    assert math.exp(2 * alloy.sigma_log) * alloy.Ktc_Pa > 1319e6 > alloy.Ktc_Pa  # the spread covers the range
    assert (sets[0].Ktc_Pa, sets[0].Kte_N_m) == (pytest.approx(767.01e6), pytest.approx(27.7e3))


def test_chip_thickness_range_is_stated_or_marked_as_assumed() -> None:
    assumed = find_milling_coefficients("al6082")
    assert assumed.h_range_m == pytest.approx((2e-5, 1.2e-4))
    assert "assumed" in assumed.source
    given = find_milling_coefficients("al6082", (1e-5, 5e-5))
    assert given.h_range_m == (1e-5, 5e-5)
    assert "assumed" not in given.source


def test_unknown_material_is_an_error() -> None:
    for find in (find_drilling_coefficients, find_milling_coefficients):
        with pytest.raises(CuttingInputError, match=r"valid: .*al7075"):
            find("al7057")
    with pytest.raises(CuttingInputError, match="no drilling coefficients"):
        find_drilling_coefficients("22")  # a number alone is ambiguous
    with pytest.raises(CuttingInputError, match="no drilling coefficients"):
        find_drilling_coefficients("vdi 29")
    with pytest.raises(CuttingInputError, match="has no Kac"):
        find_milling_coefficients("al6061")
    with pytest.raises(CuttingInputError, match="ten times"):
        find_milling_coefficients("AlMgSi0.5")
    assert find_milling_coefficients("AlMgSi0.5", accept_unusual=True).Kte_N_m == pytest.approx(204.3e3)
