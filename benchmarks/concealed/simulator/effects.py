"""Puts one effect into a world, by name. ``strength`` 1 is an ordinary size; a case scales it until it shows.

The names are those of the contract's vocabulary (the truth has to be told in it); the laws behind them are bodies,
contacts and sensors.
"""

from __future__ import annotations

from simulator import bodies, drives, gears, outside, records
from simulator.concealed import Apply, Concealed

__all__ = ["EFFECTS", "Concealed"]

EFFECTS: dict[str, Apply] = {
    "joint_nonlinear_stiffness": gears.nonlinear,
    "joint_backlash": gears.backlash,
    "joint_hysteresis": gears.hysteresis,
    "joint_creep": gears.creep,
    "joint_pose_dependent_stiffness": gears.pose_dependent,
    "link_compliance": bodies.link,
    "base_compliance": bodies.base,
    "tool_compliance": bodies.tool,
    "joint_coupling": gears.coupling,
    "gravity_compensator": gears.compensator,
    "payload": bodies.payload,
    "force_sensor_offset": records.force_offset,
    "force_sensor_gain": records.force_gain,
    "force_sensor_frame": records.force_frame,
    "displacement_frame": records.displacement_frame,
    "load_geometry": records.load_geometry,
    "joint_zero_offset": gears.zero_offset,
    "transmission_error": gears.transmission,
    "thermal_drift": bodies.thermal,
    "joint_friction": drives.friction,
    "servo_lag": drives.servo_lag,
    "joint_elasticity": drives.swinging,
    "time_skew": records.skew,
    "units": records.units,
    "outliers": records.slipped,
    "geometric_stiffness": records.geometric,
    "loose_bolt": outside.loose_bolt,
    "bearing_play": outside.bearing_play,
    "hose_spring": outside.hose,
    "bent_amplifier": outside.bent_amplifier,
    "sun_bow": outside.sun_bow,
    "tracker_kick": outside.tracker_kick,
    "gear_wear": outside.gear_wear,
    "cable_drag": outside.cable_drag,
    "rotor_inertia": outside.rotor_inertia,
    "soft_everywhere": bodies.soft_everywhere,
    "base_spin": bodies.base_spin,
    "forearm_twist": bodies.forearm_twist,
    "end_turn": bodies.end_turn,
    "flange_twist": bodies.flange_twist,
    "common_gain": records.common_gain,
}
