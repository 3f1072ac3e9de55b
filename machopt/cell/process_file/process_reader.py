"""process.yaml → :class:`machopt.data_types.process.CuttingProcess`: converts mm, rpm and percent to SI."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, radians
from pathlib import Path

from machopt.cell.process_file.process_schema import (
    DrillingKeys,
    LayerKeys,
    MaterialKeys,
    MillingKeys,
    OperationKeys,
    ProcessKeys,
    StockKeys,
    ToleranceKeys,
)
from machopt.data_types.cutting_coefficients import (
    DrillingCoefficients,
    MillingCoefficients,
    convert_spread_to_sigma,
)
from machopt.data_types.plan_options import ProcessForce
from machopt.data_types.process import (
    CuttingMaterial,
    CuttingProcess,
    ModeDamping,
    ProcessOperation,
    StackLayer,
    ToleranceLimits,
)
from machopt.data_types.stock import StockBody
from machopt.errors import CuttingInputError, suggest_nearest_word
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument, read_yaml, validate_document
from machopt.process.milling.milling_cut import check_milling_coefficients

StockReader = Callable[[YamlDocument, StockKeys], StockBody]


def load_process(path: Path | str, read_stock: StockReader | None = None) -> CuttingProcess:
    """Read process.yaml.

    Args:
        path: Path of the file.
        read_stock: Reads the mesh of the stock, whose place the cell decides, where an operation needs it; None: never.

    Returns:
        The cutting process, SI units.

    Raises:
        InputError: names file, line and key, what was found and what was expected.
    """
    document = read_yaml(Path(path))
    keys = validate_document(ProcessKeys, document)
    materials = {name: _build_material(document, name, one) for name, one in keys.materials.items()}
    operations = []
    for label, one in keys.operations.items():
        _check_materials(document, ("operations", label), one, materials)
        if one.engagement == "stock" and keys.stock is None:
            raise document.build_error(
                ("operations", label, "engagement"),
                "stock needs the part before machining; stock: {mesh: FILE, cell_mm: 0.25} would work (or ae_mm, ap_mm "
                "and cut of the operation)",
            )
        operations.append(_build_operation(label, one))
    takes_stock = any(one.takes_stock for one in operations)
    stock = None
    if keys.stock is not None and read_stock is not None and takes_stock:
        stock = read_stock(document, keys.stock)
    damping = None
    if keys.modes is not None:
        damping = ModeDamping(ratios=tuple(v / 100.0 for v in keys.modes.ratios), source=keys.modes.source)
    return CuttingProcess(
        operations=tuple(operations),
        materials=materials,
        quantile=keys.quantile,
        damping=damping,
        stock=stock,
        has_unused_stock=keys.stock is not None and not takes_stock,
        file=Path(path),
    )


def convert_spread(percent: float | None) -> float:
    """Return 1 sigma of the logarithm; 0 where no spread is stated.

    Args:
        percent: Spread in percent: the factor 1 + percent/100 is one sigma away.
    """
    return 0.0 if percent is None else convert_spread_to_sigma(percent)


def _build_material(document: YamlDocument, name: str, keys: MaterialKeys) -> CuttingMaterial:
    if keys.milling is None and keys.drilling is None:
        raise document.build_error(("materials", name), "has no coefficients; milling or drilling would work")
    return CuttingMaterial(
        name=name,
        milling=None if keys.milling is None else _build_milling(document, name, keys.milling),
        drilling=None if keys.drilling is None else _build_drilling(keys.drilling),
        has_milling_spread=keys.milling is None or keys.milling.spread_percent is not None,
        has_drilling_spread=keys.drilling is None
        or None not in (keys.drilling.thrust_spread_percent, keys.drilling.torque_spread_percent),
        accepts_unusual=keys.milling is not None and keys.milling.accept,
    )


def _build_milling(document: YamlDocument, name: str, keys: MillingKeys) -> MillingCoefficients:
    place: KeyPath = ("materials", name, "milling")
    if keys.h_mm is not None and not 0 <= keys.h_mm[0] < keys.h_mm[1]:
        raise document.build_error((*place, "h_mm"), f"found {keys.h_mm}; expected [least, largest] in mm")
    found = MillingCoefficients(
        Ktc_Pa=keys.Ktc * 1e6,
        Krc_Pa=keys.Krc * 1e6,
        Kac_Pa=keys.Kac * 1e6,
        Kte_N_m=keys.Kte * 1e3,
        Kre_N_m=keys.Kre * 1e3,
        Kae_N_m=keys.Kae * 1e3,
        h_range_m=(0.0, inf) if keys.h_mm is None else (keys.h_mm[0] / 1e3, keys.h_mm[1] / 1e3),
        sigma_log=convert_spread(keys.spread_percent),
        source=keys.source,
    )
    try:
        check_milling_coefficients(found, keys.accept)
    except CuttingInputError as error:
        raise document.build_error((*place, error.key), str(error)) from None
    return found


def _build_drilling(keys: DrillingKeys) -> DrillingCoefficients:
    return DrillingCoefficients(
        kc1_Pa=keys.kc1 * 1e6,
        mc=keys.mc,
        chisel_Pa=None if keys.chisel_N_mm2 is None else keys.chisel_N_mm2 * 1e6,
        thrust_sigma_log=convert_spread(keys.thrust_spread_percent),
        torque_sigma_log=convert_spread(keys.torque_spread_percent),
        source=keys.source,
    )


def _check_materials(
    document: YamlDocument, place: KeyPath, keys: OperationKeys, materials: dict[str, CuttingMaterial]
) -> None:
    """Refuse a material that is not listed, or that has no coefficients for the kind."""
    named: list[tuple[KeyPath, str]] = [] if keys.material is None else [((*place, "material"), keys.material)]
    named += [((*place, "layers", n, "material"), layer.material) for n, layer in enumerate(keys.layers)]
    part = "milling" if keys.kind == "milling" else "drilling"
    for where, name in named:
        if name not in materials:
            raise document.build_error(
                where, f"unknown material {name!r}; {suggest_nearest_word(name, list(materials))}"
            )
        if getattr(materials[name], part) is None:
            raise document.build_error(where, f"{name} has no {part} coefficients; materials.{name}.{part} would work")


def _build_operation(label: str, keys: OperationKeys) -> ProcessOperation:
    force = keys.force_N
    return ProcessOperation(
        label=label,
        kind=keys.kind,
        points=None if keys.points is None else (keys.points[0], keys.points[1]),
        spindle_speed=None if keys.spindle_rpm is None else keys.spindle_rpm / 60.0,
        spindle=keys.spindle,
        layers=_build_layers(keys),
        material=keys.material or "",
        depth=_convert_mm(keys.depth_mm),
        pilot=keys.pilot_mm / 1e3,
        countersink=_convert_mm(keys.countersink_mm),
        countersink_angle=None if keys.countersink_deg is None else radians(keys.countersink_deg),
        reaming_stock=_convert_mm(keys.reaming_stock_mm),
        clamp=keys.clamp_N,
        foot_friction=keys.foot_friction,
        wear=(keys.wear[0], keys.wear[1]),
        scatter=convert_spread(keys.scatter_percent),
        spread=None if keys.spread_percent is None else convert_spread(keys.spread_percent),
        ae=_convert_mm(keys.ae_mm),
        ap=_convert_mm(keys.ap_mm),
        cut=keys.cut,
        takes_stock=keys.engagement == "stock",
        is_alternating=keys.alternate,
        surface=keys.surface,
        force=None if force is None else ProcessForce(**force.model_dump(exclude_none=True)),
        rake=keys.rake_deg,
        tolerance=ToleranceLimits() if keys.tolerance is None else _build_tolerance(keys.tolerance),
    )


def _build_layers(keys: OperationKeys) -> tuple[StackLayer, ...]:
    if keys.layers:
        return tuple(_build_layer(layer) for layer in keys.layers)
    return (StackLayer(keys.material, inf),) if keys.material and keys.kind != "milling" else ()


def _build_layer(keys: LayerKeys) -> StackLayer:
    return StackLayer(keys.material, keys.thickness_mm / 1e3)


def _build_tolerance(keys: ToleranceKeys) -> ToleranceLimits:
    return ToleranceLimits(
        position=_limit(keys.position_mm) / 1e3,
        axis=radians(_limit(keys.axis_deg)),
        depth=_limit(keys.depth_mm) / 1e3,
        surface=_limit(keys.surface_mm) / 1e3,
        reference=keys.reference,
    )


def _limit(value: float | None) -> float:
    return inf if value is None else value


def _convert_mm(value: float | None) -> float | None:
    return None if value is None else value / 1e3
