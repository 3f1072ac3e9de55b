"""Joint friction beyond Coulomb and viscous friction, which are always fitted: competing laws of the motor torque.

z is the direction of motion after a short presliding displacement. Main source: Armstrong-Hélouvry, Dupont & Canudas
de Wit, Automatica 30 (1994) 1083.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from machopt.effects.joint.presliding_direction import compute_presliding_direction
from machopt.effects.protocol import JOINTS, Effect, FrictionState, JointSpeedRange, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array

SIZE_QUANTILE = 0.98  # quantile of what a law adds that counts as its size
DRAG = (0.01, 0.03, 0.08, 0.2)  # rad; presliding displacements this long come from cables or seals, not from a gear
STRIBECK = (0.03, 0.06, 0.12, 0.25, 0.5)  # Stribeck speeds tried, relative to the joint's largest speed
MAX_PEAK_SPEED_SHARE = 0.15  # relative to the largest speed; direction-dependent friction peaks below it
SOURCE = "; Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083"
VISCOUS = "N·m·s/rad"  # for a prismatic joint N·s/m


class _FrictionDefaults(ABC):
    """Default implementations shared by most friction laws."""

    word = ""
    has_memory = False
    note = ""
    size = "torque"
    plots_over_angle = False
    shape: tuple[LawParameter, ...] = ()

    @abstractmethod
    def columns(self, shape: Array, friction_state: FrictionState) -> Array:
        """Return the friction torque per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            (K, P) N·m per unit of each coefficient.
        """

    def sizes(self, values: Array, shape: Array, friction_state: FrictionState) -> dict[str, Quantity]:
        """Return the size of the added torque: a high quantile of its deviation from the median.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        added = self.columns(shape, friction_state) @ values
        unit = "N" if friction_state.is_prismatic else "N·m"
        return {self.size: Quantity(float(np.quantile(np.abs(added - np.median(added)), SIZE_QUANTILE)), unit)}

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        """Return one empty shape: the law has no shape parameters to search.

        Args:
            pace: Speeds, load variation and warm-up times that the recording covers.

        Returns:
            The shapes that a search tries.
        """
        return ((),)


def _convert_speed(at: float, friction_state: FrictionState) -> Quantity:
    return Quantity(1e3 * at, "mm/s") if friction_state.is_prismatic else Quantity(float(np.degrees(at)), "deg/s")


@dataclass(frozen=True)
class StribeckFriction(_FrictionDefaults):
    """Stribeck effect: friction increases when the speed approaches zero."""

    name = "Stribeck"
    equation = "τ_f += z F_s exp(−|q̇|/v_s)" + SOURCE
    note = "at low speed"
    size = "stribeck"
    coefficients = (LawParameter(key="stribeck_Nm", unit="N·m", lower_limit=0.0),)
    shape = (LawParameter(key="speed_rad_s", unit="rad/s", positive=True),)

    def columns(self, shape: Array, friction_state: FrictionState) -> Array:
        """Return the friction torque per unit of the Stribeck coefficient.

        Args:
            shape: (1,) Stribeck speed v_s, rad/s.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            (K, 1) dimensionless.
        """
        return np.asarray(friction_state.friction_direction * np.exp(-np.abs(friction_state.speed) / shape[0]))[:, None]

    def sizes(self, values: Array, shape: Array, friction_state: FrictionState) -> dict[str, Quantity]:
        """Return the size of the Stribeck torque and the Stribeck speed.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (1,) Stribeck speed v_s, rad/s.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        return super().sizes(values, shape, friction_state) | {
            "stribeck_speed": _convert_speed(float(shape[0]), friction_state)
        }

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        """Return the Stribeck speeds that a search tries.

        Args:
            pace: Speeds, load variation and warm-up times that the recording covers.

        Returns:
            Shapes (speed,) in rad/s.
        """
        return tuple((k * pace.max_speed,) for k in STRIBECK)


@dataclass(frozen=True)
class LoadDependentFriction(_FrictionDefaults):
    """Friction proportional to the torque that the gear transmits."""

    name = "load-dependent"
    equation = "τ_f += μ z |τ|"
    note = "grows with the load"
    coefficients = (LawParameter(key="share", unit="1", lower_limit=0.0),)

    def columns(self, shape: Array, friction_state: FrictionState) -> Array:
        """Return the friction torque per unit of the friction coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            (K, 1) N·m.
        """
        return (friction_state.friction_direction * friction_state.load)[:, None]

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        """Return one empty shape; none if the load of the joint does not vary.

        Args:
            pace: Speeds, load variation and warm-up times that the recording covers.

        Returns:
            The shapes that a search tries.
        """
        return ((),) if pace.has_varying_load else ()


@dataclass(frozen=True)
class DirectionDependentFriction(_FrictionDefaults):
    """Friction that differs between the two directions of motion."""

    name = "other in the other direction"
    equation = "τ_f += d |q̇| + F exp(−|q̇|/v)"
    note = "differs with the direction"
    size = "lopsided"
    coefficients = (LawParameter(key="viscous", unit=VISCOUS), LawParameter(key="at_low_speed_Nm", unit="N·m"))
    shape = (LawParameter(key="speed_rad_s", unit="rad/s", positive=True),)

    def columns(self, shape: Array, friction_state: FrictionState) -> Array:
        """Return the direction-independent torque terms |q̇| and exp(−|q̇|/v).

        Args:
            shape: (1,) decay speed v, rad/s.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            (K, 2) per unit of each coefficient.
        """
        v = np.abs(friction_state.speed)
        return np.stack([v, np.exp(-v / shape[0])], axis=1)

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        """Return the single decay speed that a search tries.

        Args:
            pace: Speeds, load variation and warm-up times that the recording covers.

        Returns:
            Shapes (speed,) in rad/s.
        """
        return ((MAX_PEAK_SPEED_SHARE * pace.max_speed,),)


@dataclass(frozen=True)
class CurvedViscousFriction(_FrictionDefaults):
    """Viscous friction that is nonlinear in the speed, for example shear-thinning grease."""

    name = "viscous bends"
    equation = "τ_f += d₂ q̇|q̇| + d₁ z √|q̇|: shear thinning of grease"
    note = "over speed"
    coefficients = (
        LawParameter(key="square", unit="N·m·s²/rad²"),
        LawParameter(key="root", unit="N·m·√(s/rad)"),
    )

    def columns(self, shape: Array, friction_state: FrictionState) -> Array:
        """Return the square and square-root terms of the speed.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            (K, 2) per unit of each coefficient.
        """
        v = friction_state.speed
        return np.stack([v * np.abs(v), friction_state.friction_direction * np.sqrt(np.abs(v))], axis=1)


@dataclass(frozen=True)
class CombinedFriction(_FrictionDefaults):
    """Stribeck, load-dependent and direction-dependent friction together, with warm-up if the joint warms."""

    warm: bool
    note = "over speed, load and warmth"
    size = "stribeck"

    @property
    def name(self) -> str:
        return "Stribeck, load, direction" + (", warmth" if self.warm else "")

    @property
    def equation(self) -> str:
        more = " + d_w w q̇; w from 0 to 1 as the joint warms" if self.warm else ""
        return f"τ_f += (z F_s + F_d) exp(−|q̇|/v_s) + μ z |τ|{more}{SOURCE}"

    @property
    def coefficients(self) -> tuple[LawParameter, ...]:
        three = (
            *StribeckFriction.coefficients,
            LawParameter(key="lopsided_Nm", unit="N·m"),
            *LoadDependentFriction.coefficients,
        )
        return (*three, LawParameter(key="viscous_warm", unit=VISCOUS)) if self.warm else three

    @property
    def shape(self) -> tuple[LawParameter, ...]:  # type: ignore[override]  # a property of the base is a constant
        return (*StribeckFriction.shape, *TemperatureDependentFriction.shape) if self.warm else StribeckFriction.shape

    def columns(self, shape: Array, friction_state: FrictionState) -> Array:
        """Return the friction torque per unit of each coefficient.

        Args:
            shape: Stribeck speed, rad/s, and with warm-up the time constant, s.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            (K, P) N·m per unit of each coefficient.
        """
        low, z = np.exp(-np.abs(friction_state.speed) / shape[0]), friction_state.friction_direction
        parts = [z * low, np.abs(z) * low, z * friction_state.load]
        return np.stack(
            [*parts, friction_state.warmth(float(shape[1])) * friction_state.speed] if self.warm else parts, axis=1
        )

    def sizes(self, values: Array, shape: Array, friction_state: FrictionState) -> dict[str, Quantity]:
        """Return the size of the added torque and the Stribeck speed.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: Stribeck speed, rad/s, and with warm-up the time constant, s.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        return super().sizes(values, shape, friction_state) | {
            "stribeck_speed": _convert_speed(float(shape[0]), friction_state)
        }

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        """Return the Stribeck speeds, with warm-up times if the joint warms.

        Args:
            pace: Speeds, load variation and warm-up times that the recording covers.

        Returns:
            Shapes (speed,) in rad/s or (speed, time constant) in rad/s and s.
        """
        if self.warm:
            return tuple((k * pace.max_speed, t) for k in STRIBECK for t in pace.warming_times)
        return () if pace.warming_times else tuple((k * pace.max_speed,) for k in STRIBECK)


@dataclass(frozen=True)
class CableDragFriction(_FrictionDefaults):
    """Friction of cables, hoses or seals that saturates only after a long displacement."""

    name = "dragged along"
    equation = "τ_f += F z, dz = (sgn q̇ − z) |dq|/d with a long path d: cables, hoses, seals"
    note = "after reversals"
    plots_over_angle = True
    coefficients = (LawParameter(key="drag_Nm", unit="N·m", lower_limit=0.0),)
    shape = (LawParameter(key="path_rad", unit="rad", positive=True),)

    def columns(self, shape: Array, friction_state: FrictionState) -> Array:
        """Return the presliding direction with a long displacement.

        Args:
            shape: (1,) presliding displacement d, rad.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            (K, 1) −1 to 1.
        """
        return compute_presliding_direction(
            friction_state.speed, friction_state.time_step, friction_state.segment_start, float(shape[0])
        )[:, None]

    def sizes(self, values: Array, shape: Array, friction_state: FrictionState) -> dict[str, Quantity]:
        """Return the size of the drag torque and the presliding displacement.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (1,) presliding displacement d, rad.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        d = float(shape[0])
        path = Quantity(1e3 * d, "mm") if friction_state.is_prismatic else Quantity(float(np.degrees(d)), "deg")
        return super().sizes(values, shape, friction_state) | {"path": path}

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        """Return the presliding displacements that a search tries.

        Args:
            pace: Speeds, load variation and warm-up times that the recording covers.

        Returns:
            Shapes (displacement,) in rad.
        """
        return tuple((d,) for d in DRAG)


@dataclass(frozen=True)
class TemperatureDependentFriction(_FrictionDefaults):
    """Friction that changes while the joint warms up."""

    name = "warms up"
    equation = "τ_f += (F_w z + d_w q̇) w; w from 0 to 1 as the joint warms"
    note = "over time"
    coefficients = (LawParameter(key="coulomb_warm_Nm", unit="N·m"), LawParameter(key="viscous_warm", unit=VISCOUS))
    shape = (LawParameter(key="time_constant_s", unit="s"),)  # zero: the recorded temperature

    def columns(self, shape: Array, friction_state: FrictionState) -> Array:
        """Return Coulomb and viscous terms multiplied by the warm-up state.

        Args:
            shape: (1,) warm-up time constant, s; zero means the recorded temperature.
            friction_state: Speed, direction, load and warm-up of the joint in K samples.

        Returns:
            (K, 2) per unit of each coefficient.
        """
        w = friction_state.warmth(float(shape[0]))
        return np.stack([w * friction_state.friction_direction, w * friction_state.speed], axis=1)

    def grid(self, pace: JointSpeedRange) -> tuple[Shape, ...]:
        """Return the warm-up time constants that the recording can show.

        Args:
            pace: Speeds, load variation and warm-up times that the recording covers.

        Returns:
            Shapes (time constant,) in s.
        """
        return tuple((t,) for t in pace.warming_times)


EFFECT = Effect(
    name="joint_friction",
    noun="friction",
    sentence="The motor works against friction that the model does not hold.",
    port="torque",
    places=JOINTS,
    friction_laws=(
        StribeckFriction(),
        LoadDependentFriction(),
        DirectionDependentFriction(),
        CurvedViscousFriction(),
        CombinedFriction(warm=False),
        CombinedFriction(warm=True),
        CableDragFriction(),
        TemperatureDependentFriction(),
    ),
)
