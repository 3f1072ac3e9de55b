"""Strict schema of process.yaml: its keys and their units."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from machopt.file_formats.strict_yaml import StrictSchema
from machopt.options.option_schema import ForceKeys

_GIVEN_TWICE = "write it under one operation, or under default"
_HOLE_KEYS = {"layers", "material", "depth_mm", "pilot_mm", "clamp_N", "foot_friction", "wear", "scatter_percent"}
_ROTATING = {"spindle_rpm", "spindle", "rake_deg"}
_KEYS_OF_KIND: dict[str, set[str]] = {
    "drilling": _HOLE_KEYS | _ROTATING,
    "countersinking": _HOLE_KEYS | _ROTATING | {"countersink_mm", "countersink_deg"},
    "reaming": _HOLE_KEYS | _ROTATING | {"reaming_stock_mm"},
    "milling": {"material", "ae_mm", "ap_mm", "cut", "surface", "alternate", "engagement", "wear", "scatter_percent"}
    | _ROTATING,
    "force": {"force_N", "spread_percent", "surface", "cut", "alternate", "spindle", "wear", "scatter_percent"}
    | {"depth_mm", "clamp_N", "foot_friction"},
}
_REQUIRED: dict[str, tuple[str, ...]] = {
    "drilling": (),
    "countersinking": ("countersink_mm", "countersink_deg"),
    "reaming": ("reaming_stock_mm",),
    "milling": ("material",),
    "force": ("force_N",),
}
_COMMON = {"kind", "points", "tolerance"}
_HOLE_LIMITS, _SURFACE_LIMITS = ("position_mm", "axis_deg", "depth_mm"), ("surface_mm",)

LARGEST_PRESSURE = 50_000.0  # N/mm²; ten times nickel alloys: a larger one is in Pa
LARGEST_EDGE_FORCE = 5_000.0  # N/mm; a larger one is in N/m


class MillingKeys(StrictSchema):
    Ktc: float = Field(le=LARGEST_PRESSURE, description="tangential cutting coefficient, N/mm²")
    Krc: float = Field(le=LARGEST_PRESSURE, description="radial cutting coefficient, N/mm²")
    Kac: float = Field(
        default=0.0, ge=-LARGEST_PRESSURE, le=LARGEST_PRESSURE, description="axial cutting coefficient, N/mm²"
    )
    Kte: float = Field(default=0.0, ge=0, le=LARGEST_EDGE_FORCE, description="tangential edge coefficient, N/mm")
    Kre: float = Field(
        default=0.0, ge=-LARGEST_EDGE_FORCE, le=LARGEST_EDGE_FORCE, description="radial edge coefficient, N/mm"
    )
    Kae: float = Field(
        default=0.0, ge=-LARGEST_EDGE_FORCE, le=LARGEST_EDGE_FORCE, description="axial edge coefficient, N/mm"
    )
    spread_percent: float | None = Field(default=None, ge=0, description="1 sigma of all six together")
    h_mm: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="[least, largest] chip thickness that they hold for"
    )
    source: str = Field(min_length=1, description="where the numbers come from")
    accept: bool = Field(default=False, description="true: a negative Krc, or one above Ktc, is meant")


class DrillingKeys(StrictSchema):
    kc1: float = Field(gt=0, le=LARGEST_PRESSURE, description="specific cutting force at 1 mm chip thickness, N/mm²")
    mc: float = Field(ge=0, lt=1, description="exponent of the chip thickness")
    chisel_N_mm2: float | None = Field(
        default=None, ge=0, le=LARGEST_PRESSURE, description="chisel edge, N/mm²; null: not known"
    )
    thrust_spread_percent: float | None = Field(default=None, ge=0, description="1 sigma of the thrust")
    torque_spread_percent: float | None = Field(default=None, ge=0, description="1 sigma of the torque")
    source: str = Field(min_length=1, description="where the numbers come from")


class MaterialKeys(StrictSchema):
    milling: MillingKeys | None = Field(default=None, description="coefficients of milling")
    drilling: DrillingKeys | None = Field(default=None, description="coefficients of drilling")


class LayerKeys(StrictSchema):
    material: str = Field(min_length=1, description="a name under materials")
    thickness_mm: float = Field(gt=0, description="mm")


class ToleranceKeys(StrictSchema):
    position_mm: float | None = Field(default=None, gt=0, description="± of the hole's axis across it")
    axis_deg: float | None = Field(default=None, gt=0, description="± angle of the hole's axis")
    depth_mm: float | None = Field(default=None, gt=0, description="± along the axis at depth")
    surface_mm: float | None = Field(default=None, gt=0, description="± along the surface normal")
    reference: Literal["absolute", "relative"] = Field(
        default="absolute", description="absolute: against the part's frame; relative: only repeatability counts"
    )


class OperationKeys(StrictSchema):
    HINTS: ClassVar[dict[str, str]] = {
        "rpm": "give it as spindle_rpm",
        "feed_mm_min": "the feed is that of the toolpath, as the robot drives it",
        "thickness_mm": "it belongs to layers: [{material: …, thickness_mm: …}]",
        "tolerance_mm": "give tolerance: {position_mm: …} of holes, {surface_mm: …} of milled surfaces",
    }
    kind: Literal["drilling", "countersinking", "reaming", "milling", "force"] = Field(description="what it does")
    points: list[int] | None = Field(
        default=None, min_length=2, max_length=2, description="[first, last] toolpath point, from 0"
    )
    spindle_rpm: float | None = Field(default=None, gt=0, le=1e6, description="1/min; left out: that of the CAM file")
    spindle: Literal["cw", "ccw"] = Field(default="cw", description="seen from the shank; cw is M3")
    layers: list[LayerKeys] = Field(default=[], description="of the stack, from the surface on")
    material: str | None = Field(default=None, min_length=1, description="a name under materials")
    depth_mm: float | None = Field(default=None, gt=0, description="from the surface to the deepest tip")
    pilot_mm: float = Field(default=0.0, ge=0, description="diameter of the pilot hole")
    countersink_mm: float | None = Field(default=None, gt=0, description="diameter of the countersink")
    countersink_deg: float | None = Field(default=None, gt=0, lt=180, description="included angle")
    reaming_stock_mm: float | None = Field(default=None, gt=0, description="on the diameter")
    clamp_N: float = Field(default=0.0, ge=0, description="clamp force of the pressure foot")
    foot_friction: float | None = Field(default=None, gt=0, description="coefficient of friction of the foot")
    wear: Annotated[list[float], Field(min_length=2, max_length=2)] = Field(
        default=[1.0, 1.0], description="[new, worn] factor of the force"
    )
    scatter_percent: float = Field(default=0.0, ge=0, description="1 sigma from hole to hole")
    spread_percent: float | None = Field(default=None, ge=0, description="1 sigma of a given force")
    rake_deg: float = Field(default=0.0, gt=-45, lt=45, description="rake angle of the drill's lips")
    ae_mm: float | None = Field(default=None, gt=0, description="radial depth of cut")
    ap_mm: float | None = Field(default=None, gt=0, description="axial depth of cut")
    cut: Literal["up", "down", "slot"] | None = Field(default=None, description="side of the cut")
    alternate: bool = Field(default=False, description="true: passes that reverse change between up and down")
    surface: Literal["side", "floor", "table"] = Field(default="side", description="the surface that is made")
    engagement: Literal["given", "stock"] = Field(default="given", description="source of ae and ap")
    force_N: ForceKeys | None = Field(default=None, description="a force that is known")
    tolerance: ToleranceKeys | None = Field(default=None, description="limits of the error, each ±")

    @model_validator(mode="after")
    def _check_keys_of_kind(self) -> OperationKeys:
        accepted = _KEYS_OF_KIND[self.kind] | _COMMON
        for key in sorted(self.model_fields_set - accepted):
            raise ValueError(f"{key} has no meaning for kind {self.kind}; accepted: {', '.join(sorted(accepted))}")
        for key in _REQUIRED[self.kind]:
            if getattr(self, key) is None:
                raise ValueError(f"{key} is missing; kind {self.kind} needs it")
        if self.kind in ("drilling", "countersinking", "reaming") and bool(self.layers) == bool(self.material):
            raise ValueError(f"kind {self.kind} needs layers: [{{material, thickness_mm}}, …], or one material")
        if self.kind == "milling":
            self._check_milling()
        self._check_limits()
        if not 0 < self.wear[0] <= self.wear[1]:
            raise ValueError(f"wear: found {self.wear}; expected [lowest, highest] factor above 0")
        if self.points is not None and not 0 <= self.points[0] <= self.points[1]:
            raise ValueError(f"points: found {self.points}; expected [first, last] from 0 on")
        return self

    def _check_limits(self) -> None:
        """Refuse a limit that the kind never compares with anything."""
        if self.tolerance is None:
            return
        given = sorted(self.tolerance.model_fields_set - {"reference"})
        of_hole = [key for key in given if key in _HOLE_LIMITS]
        of_surface = [key for key in given if key in _SURFACE_LIMITS]
        if not given:
            raise ValueError(
                f"tolerance: no limit is given; expected {', '.join((*_HOLE_LIMITS, *_SURFACE_LIMITS))}, each optional"
            )
        if self.kind == "milling" and of_hole:
            raise ValueError(f"tolerance.{of_hole[0]} has no meaning for kind milling; surface_mm would work")
        if self.kind == "force" and of_hole and of_surface:
            raise ValueError(
                f"tolerance: {of_hole[0]} is a limit of a hole, surface_mm one of a milled surface; expected one"
            )
        if self.kind not in ("milling", "force") and of_surface:
            raise ValueError(
                f"tolerance.surface_mm has no meaning for kind {self.kind}; {', '.join(_HOLE_LIMITS)} would work"
            )

    def _check_milling(self) -> None:
        if self.engagement == "stock":
            self._check_stock_milling()
            return
        for key in ("ae_mm", "ap_mm", "cut"):
            if getattr(self, key) is None and not (key == "ae_mm" and self.cut == "slot"):
                raise ValueError(f"{key} is missing; kind milling needs ae_mm, ap_mm and cut")

    def _check_stock_milling(self) -> None:
        """Refuse depths beside engagement from the stock, and a toleranced wall without a side."""
        for key in ("ae_mm", "ap_mm", "alternate"):
            if key in self.model_fields_set:
                raise ValueError(f"{key} has no meaning with engagement: stock, which finds it at each point")
        if self.cut == "slot":
            raise ValueError("cut: slot has no meaning with engagement: stock; up or down names the finished wall")
        if self.tolerance is not None and self.surface == "side" and self.cut is None:
            raise ValueError("cut is missing: up or down says on which side of the tool the toleranced wall lies")


class StockKeys(StrictSchema):
    mesh: str = Field(min_length=1, description="a mesh file in the cell folder, in CAM coordinates")
    cell_mm: float = Field(default=0.25, gt=0, description="cell size of the stock model")
    scale: float | None = Field(default=None, gt=0, description="metres per unit of the mesh")


class ModeDampingKeys(StrictSchema):
    damping_percent: float | list[float] = Field(description="one for all modes, or in ascending frequency")
    source: str = Field(min_length=1, description="how it was measured")

    @model_validator(mode="after")
    def _check_range(self) -> ModeDampingKeys:
        for value in self.ratios:
            if not 0 < value < 100:
                raise ValueError(f"damping_percent: found {value:g}; expected more than 0 and less than 100")
        return self

    @property
    def ratios(self) -> list[float]:
        """Damping in percent, one or more values."""
        return self.damping_percent if isinstance(self.damping_percent, list) else [self.damping_percent]


class ProcessKeys(StrictSchema):
    HINTS: ClassVar[dict[str, str]] = {
        "force_N": "give it as an operation of kind force, or as planning option force_N",
        "tolerance": _GIVEN_TWICE,
        "operation": "the key is operations",
        "material": "the key is materials",
    }
    machopt_process: Literal[1] = Field(description="the format, 1")
    quantile: float = Field(default=0.95, gt=0.5, lt=1, description="probability that `pass` needs")
    materials: dict[str, MaterialKeys] = Field(default={}, description="coefficients by name")
    operations: dict[str, OperationKeys] = Field(
        min_length=1, description="by the labels of the CAM file; `default` for every other one"
    )
    stock: StockKeys | None = Field(default=None, description="the part before machining")
    modes: ModeDampingKeys | None = Field(default=None, description="damping of the arm's modes")

    @model_validator(mode="after")
    def _check_default(self) -> ProcessKeys:
        one = self.operations.get("default")
        if one is not None and one.points is not None:
            raise ValueError("operations.default.points: default names every other point; give the range with a label")
        return self
