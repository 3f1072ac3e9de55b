"""Hidden effects that the vocabulary lacks, and the names that are right in part."""

from __future__ import annotations

from bushing_simulator.laboratory import DrawnEffect, Laboratory, state_no_parameters


def crack_base(lab: Laboratory, scale: float) -> None:
    """Let the bolts of a soft pedestal lose 60 % of their stiffness in tension."""
    lab.hidden.base_softness, lab.hidden.base_crack = scale, 0.6


def list_outside_effects(kind: str) -> list[DrawnEffect]:
    """Return the effects that the vocabulary lacks, with the names that are right in part."""
    sensor = "sensor:force"
    if kind == "deflection":
        return [
            DrawnEffect("loose_taper", "tool", "tilt soft until a gap closes",
                        lambda lab, s: setattr(lab.hidden, "taper_gap", 1e-6 * s), 60.0, state_no_parameters,
                        (("tool_compliance", "tool"), ("link_compliance", "link:6"))),
            DrawnEffect("foundation_crack", "base", "bolts open in tension",
                        crack_base,
                        60.0, state_no_parameters, (("base_compliance", "base"), ("link_compliance", "link:1"))),
            DrawnEffect("floor_tilt", "sensor:displacement", "the loaded floor turns the tracker",
                        lambda lab, s: lab.sensors.update(floor_tilt=1e-9 * s), 100.0, state_no_parameters,
                        (("base_compliance", "base"), ("displacement_frame", "sensor:displacement"))),
            DrawnEffect("gauge_drift", sensor, "amplifier gain grows",
                        lambda lab, s: lab.sensors.update(gauge_drift=0.02 * s), 15.0, state_no_parameters,
                        (("force_sensor_gain", sensor), ("units", "column:fx_N"))),
            DrawnEffect("tracker_drift", "sensor:displacement", "tracker turns in a cycle",
                        lambda lab, s: lab.sensors.update(tracker_drift=5e-6 * s), 60.0, state_no_parameters,
                        (("thermal_drift", "environment"), ("displacement_frame", "sensor:displacement"))),
        ]  # fmt: skip
    return [
        DrawnEffect("tracker_knock", "sensor:displacement", "two steps of the tracker",
                    lambda lab, s: lab.errors.update(tracker_knock=2e-5 * s), 100.0, state_no_parameters,
                    (("thermal_drift", "environment"), ("columns", "column:x_mm"))),
        DrawnEffect("warm_air", "environment", "refraction in a plume",
                    lambda lab, s: lab.errors.update(air=1e-4 * s), 100.0, state_no_parameters),
        DrawnEffect("cable_drag", "link:5", "pull towards the previous pose",
                    lambda lab, s: lab.errors.update(cable=5e-5 * s), 100.0, state_no_parameters),
        DrawnEffect("worn_seat", "tool", "flange slips when the wrist turns over",
                    lambda lab, s: lab.errors.update(worn_seat=5e-5 * s), 100.0, state_no_parameters),
        DrawnEffect("hose", "link:4", "spring to the ceiling",
                    lambda lab, s: setattr(lab.hidden, "hose", 100.0 * s), 100.0, state_no_parameters),
    ]  # fmt: skip
