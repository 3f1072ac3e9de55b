"""Lookup of cutting coefficients by name. A name that is not in the table is an error, never a similar material."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from functools import cache
from importlib import resources
from typing import Any

from machopt.data_types.cutting_coefficients import (
    DrillingCoefficients,
    MillingCoefficients,
    convert_spread_to_sigma,
)
from machopt.errors import CuttingInputError, suggest_nearest_word
from machopt.process.milling.milling_cut import check_milling_coefficients

_MILLING_KEYS = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")


def list_drilling_materials() -> list[str]:
    """Return the names that :func:`find_drilling_coefficients` knows: groups as ``vdi 22``, and materials."""
    table = _load_table()["kienzle"]
    return [*(f"vdi {group}" for group in table["groups"]), *sorted(table["names"])]


def list_milling_materials() -> list[str]:
    """Return the names that :func:`find_milling_coefficients` knows: alloys, and the single sets of them."""
    sets = _load_table()["milling"]["sets"]
    return sorted({entry["alloy"] for entry in sets.values()} | set(sets))


def find_drilling_coefficients(name: str) -> DrillingCoefficients:
    """Return the Kienzle coefficients of a VDI 3323 group or of a material that belongs to one.

    The coefficient of the chisel edge is unknown (None). The spread is that of published thrusts and torques.

    Args:
        name: ``vdi 22``, or a material; upper case and spaces do not count.

    Raises:
        CuttingInputError: the name is not in the table, or the table has no exponent for the group.
    """
    table = _load_table()["kienzle"]
    key = _simplify(name)
    names = {_simplify(n): group for n, group in table["names"].items()}
    group = str(names[key]) if key in names else key.removeprefix("vdi")
    entry = table["groups"].get(group)
    if entry is None or (key not in names and not key.startswith("vdi")):
        raise CuttingInputError(
            f"no drilling coefficients for {name!r}; {suggest_nearest_word(name, list_drilling_materials())}. "
            "Give kc1 and mc for another material",
            key="material",
        )
    if "mc" not in entry:
        raise CuttingInputError(
            f"group {group} has kc1 {entry['kc1']} N/mm², but no exponent mc in {table['source']}: give kc1 and mc",
            key="mc",
        )
    words = [table["source"], f"group {group}: {entry['material']}, {entry['condition']}"]
    spreads = {key: float(entry.get(key, table[key])) for key in ("thrust_spread_percent", "torque_spread_percent")}
    return DrillingCoefficients(
        kc1_Pa=entry["kc1"] * 1e6,
        mc=entry["mc"],
        chisel_Pa=None,
        thrust_sigma_log=convert_spread_to_sigma(spreads["thrust_spread_percent"]),
        torque_sigma_log=convert_spread_to_sigma(spreads["torque_spread_percent"]),
        source="; ".join([*words, *([entry["note"]] if "note" in entry else [])]),
    )


def find_milling_coefficients(
    name: str, h_range_m: tuple[float, float] | None = None, accept_unusual: bool = False
) -> MillingCoefficients:
    """Return the milling coefficients of one published set, or of an alloy: geometric means of its sets.

    Args:
        name: a set or an alloy of :func:`list_milling_materials`; upper case and spaces do not count.
        h_range_m: m, range of chip thickness for which they are used; None: that of the table, which is assumed, and
            the source says so.
        accept_unusual: accept a set that the table marks as suspect.

    Raises:
        CuttingInputError: the name is not in the table, the set lacks a coefficient, or it is suspect.
    """
    table = _load_table()["milling"]
    wanted = _simplify(name)
    sets = {n: e for n, e in table["sets"].items() if wanted in (_simplify(n), _simplify(e["alloy"]))}
    if not sets:
        raise CuttingInputError(
            f"no milling coefficients for {name!r}; {suggest_nearest_word(name, list_milling_materials())}. "
            "Give Ktc, Krc, Kac, Kte, Kre and Kae for another material",
            key="material",
        )
    suspect = [f"{n}: {e['suspect']}" for n, e in sets.items() if "suspect" in e]
    if suspect and not accept_unusual:
        raise CuttingInputError(
            f"{suspect[0]}. Accept it with `accept: true`, or give the coefficients", key="material"
        )
    values = {}
    for key in _MILLING_KEYS:
        known = [float(e[key]) for e in sets.values() if key in e]
        if not known:
            raise CuttingInputError(f"{name!r} has no {key} in {table['source']}: give all six coefficients", key=key)
        values[key] = math.exp(math.fsum(map(math.log, known)) / len(known))
    low, high = h_range_m or tuple(1e-3 * h for h in table["h_mm"])
    found = MillingCoefficients(
        Ktc_Pa=values["Ktc"] * 1e6,
        Krc_Pa=values["Krc"] * 1e6,
        Kac_Pa=values["Kac"] * 1e6,
        Kte_N_m=values["Kte"] * 1e3,
        Kre_N_m=values["Kre"] * 1e3,
        Kae_N_m=values["Kae"] * 1e3,
        h_range_m=(low, high),
        sigma_log=convert_spread_to_sigma(float(table["spread_percent"])),
        source=table["source"],
    )
    check_milling_coefficients(found, accept_unusual)
    return replace(found, source=_describe_sets(table, sets, h_range_m is None))


def _describe_sets(table: dict[str, Any], sets: dict[str, Any], assumed: bool) -> str:
    words = [table["source"]]
    if len(sets) == 1:
        words += [f"{n}, {e['tool']}" for n, e in sets.items()]
    else:
        range_of = [e["Ktc"] for e in sets.values()]
        words.append(f"geometric mean of {', '.join(sets)} (Ktc {min(range_of):.0f} to {max(range_of):.0f} N/mm²)")
    if assumed:
        words.append(f"chip thickness {table['h_mm'][0]:g} to {table['h_mm'][1]:g} mm assumed")
    return "; ".join(words)


def _simplify(name: str) -> str:
    return "".join(name.split()).casefold()


@cache
def _load_table() -> dict[str, Any]:
    text = (resources.files("machopt.process.materials") / "materials.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)
