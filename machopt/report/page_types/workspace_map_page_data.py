"""Data of the map page in SI; :mod:`machopt.report.page_data.workspace_map` fills it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.report.page_types.display_units import ANGLE, DIMENSIONLESS, FINE_LENGTH, LENGTH, SHARE, DisplayUnit
from machopt.report.scene.scene_types import CellScene

BoolArray = NDArray[np.bool_]
FieldUnit = Literal["N/m", "m", "rad", "1", "share"]

FIELD_UNITS: dict[FieldUnit, DisplayUnit] = {
    "N/m": DisplayUnit(1e-3, "N/mm", 0),
    "m": FINE_LENGTH,
    "rad": DisplayUnit(ANGLE.factor, "deg", 3),
    "1": DIMENSIONLESS,
    "share": SHARE,
}


@dataclass(frozen=True)
class MapAxis:
    """Sampling axis of a map."""

    name: str  # "x", "a2", "s"
    label: str  # for the axis of a picture, without unit
    unit: Literal["m", "rad"]
    values: Array  # (n,)

    @property
    def display_unit(self) -> DisplayUnit:
        return LENGTH if self.unit == "m" else ANGLE


@dataclass(frozen=True, kw_only=True)
class MapField:
    """Quantity of a map."""

    key: str
    name: str
    unit: FieldUnit
    better: Literal["more", "less", "none"]
    note: str
    model: str = ""  # of what was measured: the key of the same by the model

    @property
    def display_unit(self) -> DisplayUnit:
        return FIELD_UNITS[self.unit]


@dataclass(frozen=True, kw_only=True)
class MapLayer:
    """M samples under one choice of rotation; M runs over the axes, the last fastest."""

    name: str
    title: str
    value: dict[str, Array]  # key of a field → (M,), NaN where there is none
    reason: NDArray[np.uint8]  # (M,) PlaceCode, which indexes ``MapPageData.reasons``; 0: a posture was found
    q: Array  # (M, 6) rad
    gamma: Array  # (M,) rad
    shortfall: Array  # (M,) m
    best: int  # row that is best by the criterion, −1 where none
    guess: dict[str, BoolArray] = field(default_factory=dict)  # key → (M,) True: a number, but not to be trusted


@dataclass(frozen=True, kw_only=True)
class ArmLines:
    """The arm as lines, in the map's frame at q = 0."""

    joints: tuple[str, ...]
    axis: Array  # (6, 3) unit
    point: Array  # (6, 3) m
    base: Array  # (3,) m, origin of base_link
    up: Array  # (3,) unit, z of base_link
    flange: Array  # (3,) m
    tcp: Array  # (3,) m


@dataclass(frozen=True)
class MapScene:
    """3-D view of the cell, and the position of the map in it."""

    scene: CellScene
    T_base_frame: Array  # (4, 4) the map's axes in base_link
    external: Array  # (E,) rad or m, where external joints stand


@dataclass(frozen=True, kw_only=True)
class MeasuredView:
    """P measured readings with the model's values."""

    file: str
    axes: tuple[str, ...]
    position: Array  # (P, 3) m
    measured: Array  # (P, F) N/m
    left_out: Array  # (P, F) N/m
    model: Array  # (P, F) N/m
    held_stiffness: Array  # (P, F) N/m
    errors: dict[str, dict[str, float | None]]  # axis → left_out_rms, model_rms, held_rms … as shares
    from_joints: bool
    power: float


@dataclass(frozen=True, kw_only=True)
class MapPageData:
    """Everything on the page."""

    title: str
    cell: str
    version: str
    kind: Literal["slice", "volume", "line", "joints"]
    frame: str
    place: str  # what was mapped, in words
    axes: tuple[MapAxis, ...]
    fixed: Array  # (3,) m, coordinates no axis runs along; for a line its start
    end: Array | None  # (3,) m, end of a line
    fields: tuple[MapField, ...]
    layers: tuple[MapLayer, ...]
    criterion: str  # key
    reasons: tuple[str, ...]  # words by PlaceCode
    arm: ArmLines
    verdict: str
    warnings: tuple[str, ...]
    measured: MeasuredView | None = None
    options: tuple[tuple[str, str], ...] = ()
    hashes: tuple[tuple[str, str], ...] = ()
    space: MapScene | None = None  # None: only the drawings

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(a.values) for a in self.axes)

    @property
    def shown_field(self) -> MapField:
        return next(f for f in self.fields if f.key == self.criterion)
