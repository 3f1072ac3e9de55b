"""The tool: a beam from the flange to the TCP, a spring at the TCP, a body of revolution, or cylinders on a sensor.

Matrices stand in axes that turn with the tool, x out of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from machopt.effects.compliance_matrices.beam_compliance import BeamCylinder, compute_stepped_beam_compliance
from machopt.effects.compliance_matrices.body_compliance_laws import (
    DIAGONAL_ENTRIES,
    LEAST_LENGTH,
    MATRIX,
    UNITS,
    BodyLawDefaults,
    MatrixEntriesLaw,
    UniformBeamLaw,
    read_body_law,
)
from machopt.effects.compliance_matrices.semidefinite_projection import find_nearest_semidefinite
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import BodyLaw, CompliantBody, Effect, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors, skew_matrix

MIN_ALIGNMENT = 0.999  # cosine between tool axis and line from the flange, from which on they are one
NOTE = "constant in the tool frame"
SENSOR = ("sensor_N_per_mm", "sensor_Nm_per_rad")
SHIFT_PARAMETER = LawParameter(key="shift", unit=UNITS[0], lower_limit=0.0)  # of a body of revolution
TILT_PARAMETER = LawParameter(key="tilt", unit=UNITS[2], lower_limit=0.0)
COUPLING_PARAMETER = LawParameter(key="both", unit=UNITS[1])
TWIST_PARAMETER = LawParameter(key="twist", unit=UNITS[2], lower_limit=0.0)


@dataclass(frozen=True)
class ToolBeam(UniformBeamLaw):
    """A beam from the flange to the TCP."""

    keys: tuple[str, ...] = ("EI_Nm2",)

    @property
    def equation(self) -> str:
        return "cantilever from the flange to the TCP"

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """A force at its end does not twist it."""
        return self if dimensions == 6 and turning else replace(self, keys=("EI_Nm2",))


@dataclass(frozen=True)
class ToolTipSpring(MatrixEntriesLaw):
    """A spring at the tip along the axes of the tool; readings of places alone show its shifts alone."""

    pairs: tuple[tuple[int, int], ...] = DIAGONAL_ENTRIES
    name: str = "spring at the tool"
    equation: str = "R C Rᵀ w, C diagonal in tool axes"

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"lateral_compliance": Quantity(1e6 * float(np.max(np.abs(values[:3]))), "µm/N")}

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        return self if dimensions == 6 and turning else replace(self, pairs=DIAGONAL_ENTRIES[:3])


@dataclass(frozen=True)
class ToolTipMatrix(MatrixEntriesLaw):
    """Any symmetric compliance at the tip; of what the loads and readings can show."""

    equation: str = "R C Rᵀ w at the TCP, C symmetric"
    note: str = NOTE

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        sideways = [abs(float(v)) for pair, v in zip(self.pairs, values, strict=True) if pair in DIAGONAL_ENTRIES[1:3]]
        tilts = [abs(float(v)) for pair, v in zip(self.pairs, values, strict=True) if pair in DIAGONAL_ENTRIES[4:]]
        tilt = {"tilt_compliance": Quantity(max(tilts), UNITS[2])} if tilts else {}
        return {"lateral_compliance": Quantity(1e6 * max(sideways), "µm/N"), **tilt}

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        # where moments or turning are missing no reading holds the tilts, and any of them makes any coupling possible
        if dimensions == 6 and turning:
            return self
        return replace(self, pairs=tuple(p for p in self.pairs if max(p) < 3))


@dataclass(frozen=True)
class RotationallySymmetricTool(BodyLawDefaults):
    """A body of revolution seen from the TCP: lateral shift, tilt, what couples them, and the twist about its axis."""

    line: bool  # about the line from the flange to the TCP; else about the tool's axis
    note = NOTE
    equation = "R C Rᵀ w at the TCP, C of a body of revolution"
    coefficients: tuple[LawParameter, ...] = (SHIFT_PARAMETER, TILT_PARAMETER, COUPLING_PARAMETER)

    @property
    def name(self) -> str:
        said = "bends about the line from flange to TCP" if self.line else "round, bends and tilts"
        return f"{said}, twists" if TWIST_PARAMETER in self.coefficients else said

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """Places under forces show its shift alone; a twist is turned by a moment."""
        shown = 4 if dimensions == 6 and turning else 3 if dimensions == 6 or turning else 1
        return replace(self, coefficients=self.coefficients[:shown])

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        made = np.zeros((4, 6, 6))
        made[0, 1, 1] = made[0, 2, 2] = made[1, 4, 4] = made[1, 5, 5] = 1.0
        made[2, 1, 5] = made[2, 5, 1] = 1.0
        made[2, 2, 4] = made[2, 4, 2] = -1.0
        made[3, 3, 3] = 1.0
        made = made[: len(self.coefficients)]
        if not self.line:
            return made
        turn = np.kron(np.eye(2), _build_axes_along(_compute_tool_line(body)))
        return np.asarray(turn @ made @ turn.T)

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        return {MATRIX: np.einsum("p,pij->ij", values, self.matrices(shape, body)).tolist()}

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        tilt = {"tilt_compliance": Quantity(abs(float(values[1])), UNITS[2])} if len(values) > 1 else {}
        return {"lateral_compliance": Quantity(1e6 * abs(float(values[0])), "µm/N"), **tilt}

    def project_to_admissible(self, values: Array, metric: Array) -> Array:
        return find_nearest_semidefinite(values, ((0, 0), (1, 1), (0, 1), (2, 2))[: len(values)], metric)

    def grid(self, body: CompliantBody) -> tuple[Shape, ...]:
        if not self.line:
            return ((),)
        line, length = _compute_tool_line(body), float(np.linalg.norm(_compute_tool_line(body)))
        return () if length < LEAST_LENGTH or abs(line[0]) > MIN_ALIGNMENT * length else ((),)


@dataclass(frozen=True)
class SteppedToolAndSensor(BodyLawDefaults):
    """Stepped cylinders and a force sensor at the flange, whose compliance at the TCP is known but for a scale."""

    fixed: Array = field(compare=False)  # (6, 6) at the TCP, axes of the tool
    file_parameters: Mapping[str, Any] = field(compare=False)  # as the file states them
    name = "cylinders from flange to tip"
    equation = "tian2025 eqs. 2–3, with lever arms"
    coefficients = (LawParameter(key="scale", unit="1", lower_limit=0.0),)

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        return self.fixed[None]

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        return {**self.file_parameters, "scale": float(values[0])}

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"scale": Quantity(float(values[0]), "1")}


def _compute_tool_line(body: CompliantBody) -> Array:
    """(3,) m from the flange to the TCP, axes of the tool."""
    assert body.root is not None  # a tool begins at its flange
    return np.asarray(-body.root[:3, 3])


def _build_axes_along(line: Array) -> Array:
    """(3, 3) axes whose x is along the line; which way y points makes no difference to a body of revolution."""
    x = normalise_vectors(line)
    y = normalise_vectors(np.cross(np.eye(3)[int(np.abs(x).argmin())], x))
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _read_tool_law(given: ParameterReader, body: CompliantBody) -> tuple[BodyLaw, Array, Array, CompliantBody]:
    if not given.has_key("cylinders"):
        return read_body_law(given, body)
    fixed, stated = _read_stepped_tool(given, body)
    return SteppedToolAndSensor(fixed, stated), np.array([given.read_number("scale", 1.0)]), np.empty(0), body


def _read_stepped_tool(given: ParameterReader, body: CompliantBody) -> tuple[Array, dict[str, Any]]:
    """Stepped cylinders (tian2025 eqs. 2–3, with lever arms) and a force sensor at the flange, seen from the TCP."""
    stated: dict[str, Any] = {"cylinders": given.read_mappings("cylinders")}
    steps = []
    for n, entry in enumerate(stated["cylinders"]):
        one = given.read_nested(f"cylinders[{n}]", entry)
        bore = one.read_number("bore_mm", 0.0, positive=False) / 1e3
        step = BeamCylinder(
            one.read_number("diameter_mm") / 1e3,
            one.read_number("length_mm") / 1e3,
            one.read_number("youngs_GPa") * 1e9,
            one.read_number("poisson", 0.3),
            bore,
        )
        one.refuse_unread_keys()
        if not 0 <= bore < step.diameter:
            raise one.build_error("bore_mm", "expected at least 0 and less than the diameter")
        steps.append(step)
    C = compute_stepped_beam_compliance(steps)
    asked = [given.has_key(key) for key in SENSOR]  # both, so that neither is an unknown key
    if any(asked):
        # the sensor sits at the flange, its axes are the flange's
        linear = given.read_array(SENSOR[0], (3,), np.full(3, np.inf)) * 1e3
        angular = given.read_array(SENSOR[1], (3,), np.full(3, np.inf))
        for key, values in zip(SENSOR, (linear, angular), strict=True):
            if not (values > 0).all():
                raise given.build_error(key, "expected three stiffnesses above zero")
            if np.isfinite(values).all():
                stated[key] = (values / (1e3 if key.endswith("mm") else 1.0)).tolist()
        assert body.root is not None  # a tool begins at its flange
        turn, G = np.kron(np.eye(2), body.root[:3, :3]), np.eye(6)
        G[:3, 3:] = -skew_matrix(-body.root[:3, 3])
        C = C + G @ turn @ np.diag(np.concatenate([1.0 / linear, 1.0 / angular])) @ turn.T @ G.T
    return C, stated


EFFECT = Effect(
    name="tool_compliance",
    noun="compliance",
    short_noun="tool compliance",
    sentence="Flange, force sensor, spindle or holder bend behind the tool tip.",
    port="body",
    places=("tool",),
    body_laws=(
        ToolBeam(),
        ToolBeam(("EI_Nm2", "GJ_Nm2")),
        ToolTipSpring(),
        RotationallySymmetricTool(line=False),
        RotationallySymmetricTool(line=True),
        RotationallySymmetricTool(
            line=False, coefficients=(SHIFT_PARAMETER, TILT_PARAMETER, COUPLING_PARAMETER, TWIST_PARAMETER)
        ),
        RotationallySymmetricTool(
            line=True, coefficients=(SHIFT_PARAMETER, TILT_PARAMETER, COUPLING_PARAMETER, TWIST_PARAMETER)
        ),
        ToolTipMatrix(),
    ),
    file_reader=_read_tool_law,
    is_elastic=True,
)
