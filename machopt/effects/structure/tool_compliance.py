"""Tool compliance: a beam from flange to TCP, a spring at the TCP, a body of revolution, or cylinders on a force
sensor.

Matrices are stated in axes that rotate with the tool, x outward.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from machopt.effects.compliance_matrices.beam_compliance import BeamCylinder, compute_stepped_beam_compliance
from machopt.effects.compliance_matrices.body_compliance_laws import (
    DIAGONAL_ENTRIES,
    UNITS,
    MatrixEntriesLaw,
    read_body_law,
)
from machopt.effects.compliance_matrices.semidefinite_projection import find_nearest_semidefinite
from machopt.effects.compliance_matrices.uniform_beam_law import LEAST_LENGTH, MATRIX, BodyLawDefaults, UniformBeamLaw
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import BodyLaw, CompliantBody, Effect, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors, skew_matrix

MIN_ALIGNMENT = 0.999  # cosine between tool axis and flange–TCP line above which both are treated as equal
NOTE = "constant in the tool frame"
SENSOR = ("sensor_N_per_mm", "sensor_Nm_per_rad")
SHIFT_PARAMETER = LawParameter(key="shift", unit=UNITS[0], lower_limit=0.0)  # of a body of revolution
TILT_PARAMETER = LawParameter(key="tilt", unit=UNITS[2], lower_limit=0.0)
COUPLING_PARAMETER = LawParameter(key="both", unit=UNITS[1])
TWIST_PARAMETER = LawParameter(key="twist", unit=UNITS[2], lower_limit=0.0)


@dataclass(frozen=True)
class ToolBeam(UniformBeamLaw):
    """Beam from the flange to the TCP."""

    keys: tuple[str, ...] = ("EI_Nm2",)

    @property
    def equation(self) -> str:
        return "cantilever from the flange to the TCP"

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """Drop torsion if the readings cannot determine it: a force at the end does not twist the beam.

        Args:
            dimensions: Number of measured coordinates: 3 (position) or 6 (pose).
            turning: Whether the loads include moments that rotate the tool.

        Returns:
            The reduced law.
        """
        return self if dimensions == 6 and turning else replace(self, keys=("EI_Nm2",))


@dataclass(frozen=True)
class ToolTipSpring(MatrixEntriesLaw):
    """Spring at the tool tip along the tool axes. Position readings determine its translations only."""

    pairs: tuple[tuple[int, int], ...] = DIAGONAL_ENTRIES
    name: str = "spring at the tool"
    equation: str = "R C Rᵀ w, C diagonal in tool axes"

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the largest translational compliance.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            ``lateral_compliance`` in µm/N.
        """
        return {"lateral_compliance": Quantity(1e6 * float(np.max(np.abs(values[:3]))), "µm/N")}

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """Drop the rotations if the readings cannot determine them.

        Args:
            dimensions: Number of measured coordinates: 3 (position) or 6 (pose).
            turning: Whether the loads include moments that rotate the tool.

        Returns:
            The reduced law.
        """
        return self if dimensions == 6 and turning else replace(self, pairs=DIAGONAL_ENTRIES[:3])


@dataclass(frozen=True)
class ToolTipMatrix(MatrixEntriesLaw):
    """Symmetric compliance matrix at the tool tip, reduced to the entries that loads and readings can determine."""

    equation: str = "R C Rᵀ w at the TCP, C symmetric"
    note: str = NOTE

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the largest lateral and tilt compliances.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            ``lateral_compliance`` in µm/N first, ``tilt_compliance`` in rad/(N·m).
        """
        sideways = [abs(float(v)) for pair, v in zip(self.pairs, values, strict=True) if pair in DIAGONAL_ENTRIES[1:3]]
        tilts = [abs(float(v)) for pair, v in zip(self.pairs, values, strict=True) if pair in DIAGONAL_ENTRIES[4:]]
        tilt = {"tilt_compliance": Quantity(max(tilts), UNITS[2])} if tilts else {}
        return {"lateral_compliance": Quantity(1e6 * max(sideways), "µm/N"), **tilt}

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        # without moments or measured rotations the tilts are undetermined, and so are their couplings
        """Drop the rotational entries if the readings cannot determine them.

        Args:
            dimensions: Number of measured coordinates: 3 (position) or 6 (pose).
            turning: Whether the loads include moments that rotate the tool.

        Returns:
            The reduced law.
        """
        if dimensions == 6 and turning:
            return self
        return replace(self, pairs=tuple(p for p in self.pairs if max(p) < 3))


@dataclass(frozen=True)
class RotationallySymmetricTool(BodyLawDefaults):
    """Body of revolution at the TCP: lateral compliance, tilt, their coupling, and torsion about its axis."""

    line: bool  # symmetric about the line from flange to TCP; else about the tool axis
    note = NOTE
    equation = "R C Rᵀ w at the TCP, C of a body of revolution"
    coefficients: tuple[LawParameter, ...] = (SHIFT_PARAMETER, TILT_PARAMETER, COUPLING_PARAMETER)

    @property
    def name(self) -> str:
        bending = "bends about the line from flange to TCP" if self.line else "round, bends and tilts"
        return f"{bending}, twists" if TWIST_PARAMETER in self.coefficients else bending

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """Drop the coefficients that the readings cannot determine.

        Positions under forces determine the lateral compliance only. Torsion requires a moment.

        Args:
            dimensions: Number of measured coordinates: 3 (position) or 6 (pose).
            turning: Whether the loads include moments that rotate the tool.

        Returns:
            The reduced law.
        """
        shown = 4 if dimensions == 6 and turning else 3 if dimensions == 6 or turning else 1
        return replace(self, coefficients=self.coefficients[:shown])

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        """Return the compliance matrices per unit of each coefficient.

        Args:
            shape: Empty; the law has no shape parameters.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            (P, 6, 6) compliance at the TCP in tool axes.
        """
        basis = np.zeros((4, 6, 6))
        basis[0, 1, 1] = basis[0, 2, 2] = basis[1, 4, 4] = basis[1, 5, 5] = 1.0
        basis[2, 1, 5] = basis[2, 5, 1] = 1.0
        basis[2, 2, 4] = basis[2, 4, 2] = -1.0
        basis[3, 3, 3] = 1.0
        basis = basis[: len(self.coefficients)]
        if not self.line:
            return basis
        turn = np.kron(np.eye(2), _build_axes_along(_compute_tool_line(body)))
        return np.asarray(turn @ basis @ turn.T)

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        """Return the compliance matrix as a file states it.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            ``compliance`` (6 × 6).
        """
        return {MATRIX: np.einsum("p,pij->ij", values, self.matrices(shape, body)).tolist()}

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the lateral and tilt compliances.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            ``lateral_compliance`` in µm/N first, ``tilt_compliance`` in rad/(N·m).
        """
        tilt = {"tilt_compliance": Quantity(abs(float(values[1])), UNITS[2])} if len(values) > 1 else {}
        return {"lateral_compliance": Quantity(1e6 * abs(float(values[0])), "µm/N"), **tilt}

    def project_to_admissible(self, values: Array, metric: Array) -> Array:
        """Return the nearest coefficients of a positive semidefinite compliance.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            metric: (P, P) weight matrix of the least-squares problem: dᵀ metric d is the increase of the residual
                sum for a change d.

        Returns:
            (P,) admissible coefficients.
        """
        return find_nearest_semidefinite(values, ((0, 0), (1, 1), (0, 1), (2, 2))[: len(values)], metric)

    def grid(self, body: CompliantBody) -> tuple[Shape, ...]:
        """Return one empty shape; none if the flange–TCP line coincides with the tool axis.

        Args:
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            The shapes that a search tries.
        """
        if not self.line:
            return ((),)
        line, length = _compute_tool_line(body), float(np.linalg.norm(_compute_tool_line(body)))
        return () if length < LEAST_LENGTH or abs(line[0]) > MIN_ALIGNMENT * length else ((),)


@dataclass(frozen=True)
class SteppedToolAndSensor(BodyLawDefaults):
    """Stepped cylinders and a force sensor at the flange. Their compliance at the TCP is known except for a scale
    factor.
    """

    fixed: Array = field(compare=False)  # (6, 6) at the TCP, axes of the tool
    file_parameters: Mapping[str, Any] = field(compare=False)  # parameters of the file's entry
    name = "cylinders from flange to tip"
    equation = "tian2025 eqs. 2–3, with lever arms"
    coefficients = (LawParameter(key="scale", unit="1", lower_limit=0.0),)

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        """Return the known compliance matrix.

        Args:
            shape: Empty; the law has no shape parameters.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            (1, 6, 6) compliance at the TCP in tool axes.
        """
        return self.fixed[None]

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        """Return the file's parameters with the fitted scale factor.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            Keys and values in the units of the keys.
        """
        return {**self.file_parameters, "scale": float(values[0])}

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the scale factor.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            ``scale``.
        """
        return {"scale": Quantity(float(values[0]), "1")}


def _compute_tool_line(body: CompliantBody) -> Array:
    """(3,) m from the flange to the TCP, axes of the tool."""
    assert body.root is not None  # a tool begins at its flange
    return np.asarray(-body.root[:3, 3])


def _build_axes_along(line: Array) -> Array:
    """Return axes (3, 3) with x along the line. The direction of y is arbitrary for a body of revolution."""
    x = normalise_vectors(line)
    y = normalise_vectors(np.cross(np.eye(3)[int(np.abs(x).argmin())], x))
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _read_tool_law(reader: ParameterReader, body: CompliantBody) -> tuple[BodyLaw, Array, Array, CompliantBody]:
    if not reader.has_key("cylinders"):
        return read_body_law(reader, body)
    fixed, stated = _read_stepped_tool(reader, body)
    return SteppedToolAndSensor(fixed, stated), np.array([reader.read_number("scale", 1.0)]), np.empty(0), body


def _read_stepped_tool(reader: ParameterReader, body: CompliantBody) -> tuple[Array, dict[str, Any]]:
    """Return the compliance at the TCP of stepped cylinders (tian2025 eqs. 2–3, with lever arms) and a force sensor."""
    stated: dict[str, Any] = {"cylinders": reader.read_mappings("cylinders")}
    steps = []
    for n, entry in enumerate(stated["cylinders"]):
        one = reader.read_nested(f"cylinders[{n}]", entry)
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
    given_keys = [reader.has_key(key) for key in SENSOR]  # both, so that neither is an unknown key
    if any(given_keys):
        # the sensor sits at the flange, its axes are the flange's
        linear = reader.read_array(SENSOR[0], (3,), np.full(3, np.inf)) * 1e3
        angular = reader.read_array(SENSOR[1], (3,), np.full(3, np.inf))
        for key, values in zip(SENSOR, (linear, angular), strict=True):
            if not (values > 0).all():
                raise reader.build_error(key, "expected three stiffnesses above zero")
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
