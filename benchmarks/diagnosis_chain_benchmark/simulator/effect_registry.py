"""Puts one effect into a world, by name. ``strength`` 1 is an ordinary size; a case scales it until it shows.

The names are those of the contract's vocabulary (the truth has to be told in it); the laws behind them are bodies,
contacts and sensors.
"""

from __future__ import annotations

from simulator import drive_effects, gear_effects, recording_effects, structure_effects, uncatalogued_effects
from simulator.hidden_effect import Apply, HiddenEffect

__all__ = ["EFFECTS", "HiddenEffect"]

EFFECTS: dict[str, Apply] = {
    "joint_nonlinear_stiffness": gear_effects.nonlinear,
    "joint_backlash": gear_effects.backlash,
    "joint_hysteresis": gear_effects.hysteresis,
    "joint_creep": gear_effects.creep,
    "joint_pose_dependent_stiffness": gear_effects.pose_dependent,
    "link_compliance": structure_effects.link,
    "base_compliance": structure_effects.base,
    "tool_compliance": structure_effects.tool,
    "joint_coupling": gear_effects.coupling,
    "gravity_compensator": gear_effects.compensator,
    "payload": structure_effects.payload,
    "force_sensor_offset": recording_effects.force_offset,
    "force_sensor_gain": recording_effects.force_gain,
    "force_sensor_frame": recording_effects.force_frame,
    "displacement_frame": recording_effects.displacement_frame,
    "load_geometry": recording_effects.load_geometry,
    "joint_zero_offset": gear_effects.zero_offset,
    "transmission_error": gear_effects.transmission,
    "thermal_drift": structure_effects.thermal,
    "joint_friction": drive_effects.friction,
    "servo_lag": drive_effects.servo_lag,
    "joint_elasticity": drive_effects.swinging,
    "time_skew": recording_effects.skew,
    "units": recording_effects.units,
    "outliers": recording_effects.slipped,
    "geometric_stiffness": recording_effects.geometric,
    "loose_bolt": uncatalogued_effects.loose_bolt,
    "bearing_play": uncatalogued_effects.bearing_play,
    "hose_spring": uncatalogued_effects.hose,
    "bent_amplifier": uncatalogued_effects.bent_amplifier,
    "sun_bow": uncatalogued_effects.sun_bow,
    "tracker_kick": uncatalogued_effects.tracker_kick,
    "gear_wear": uncatalogued_effects.gear_wear,
    "cable_drag": uncatalogued_effects.cable_drag,
    "rotor_inertia": uncatalogued_effects.rotor_inertia,
    "soft_everywhere": structure_effects.soft_everywhere,
    "base_spin": structure_effects.base_spin,
    "forearm_twist": structure_effects.forearm_twist,
    "end_turn": structure_effects.end_turn,
    "flange_twist": structure_effects.flange_twist,
    "common_gain": recording_effects.common_gain,
}
