"""What is sealed: which physics was put in, how much of it a record of this design can show, what else may be said."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.case_simulation import Scene, Simulated
from simulator.detectability import jacobians, rms
from simulator.sensor_readings import Table

Array = NDArray[np.float64]
ABSORBED = 3.0  # noncentrality below which nothing is left to find


def build_truth(scene: Scene, name: str, which: str, table: Table, out: Simulated) -> dict[str, Any]:
    """The truth of one case as JSON holds it."""
    case = scene.case
    n = len(case.parts)
    without = scene.simulate([0.0] * n) if n else out
    noise, unit, scale = scene.unit(out.world)
    effects = [_effect(scene, k, without, out, table) for k in range(n)]
    dirt, dirt_z = scene.leftover_of_null(without)
    visible = [e for e in effects if e["noncentrality"] is None or e["noncentrality"] >= ABSORBED]
    if not visible:
        verdicts = ["consistent"]
    elif case.group == "outside":
        verdicts = ["unexplained", "partly_explained"]
        if case.parts[0].effect == "rotor_inertia":
            verdicts.append("consistent")  # a base that refits rotors takes it in
    else:
        verdicts = ["explained", "partly_explained"]
    return {
        "machopt_concealed_truth": 1,
        "case": name,
        "key": case.key,
        "set": which,
        "seed": list(scene.seed),
        "group": case.group,
        "kind": case.kind,
        "channel": case.channel,
        "robot": scene.nominal.name,
        "ugly": case.ugly,
        "readings": len(table.clean),
        "verdicts": verdicts,
        "effects": effects,
        "ambient": _ambient(scene, out, dirt, dirt_z),
        "true_stiffness_Nm_per_rad": scene.true_stiffness().tolist(),
        "nominal_stiffness_Nm_per_rad": scene.nominal.stiffness.tolist(),
        "outlier_rows": table.outliers.tolist(),
        "noise": {"unit": unit, "one_reading": _in_unit(noise, unit)},
        "dirt": {"ratio_to_noise": dirt, "noncentrality": dirt_z},
        "oracle": _oracle(scene, table, out, unit, scale),
    }


def _effect(scene: Scene, k: int, without: Simulated, out: Simulated, table: Table) -> dict[str, Any]:
    case, part = scene.case, scene.case.parts[k]
    alone = [s if j == k else 0.0 for j, s in enumerate(scene.strengths)]
    one = scene.simulate(alone) if len(case.parts) > 1 else out
    found = one.found[0]
    e = scene.curvature(one) if part.effect == "geometric_stiffness" else scene.contribution(one, without)
    base = scene.base(one)
    left, z = base.left(e)
    noise, unit, scale = scene.unit(one.world)
    wide = 6 if case.kind == "motion" and case.channel != "tip" else 3
    before, after = rms(e[:, :wide] / scale) / noise, rms(left[:, :wide] / scale) / noise
    binary = part.effect in ("units", "outliers")
    accepted = [(found.effect, found.location)]
    for other in [*found.accepted, *scene.accepted(one, e)]:
        if other not in accepted:
            accepted.append(other)
    location = found.location
    if part.effect == "outliers":
        location = "rows:" + ",".join(map(str, table.outliers.tolist()))
        accepted = [("outliers", location)]
    return {
        "effect": found.effect,
        "location": location,
        "in_catalogue": found.catalogue,
        "level": part.level,
        "law": found.law,
        "strength": scene.strengths[k],
        "parameters": {name: {"value": float(v), "unit": u} for name, (v, u) in found.parameters.items()},
        "size": {"value": float(found.size[0]), "unit": found.size[1]},
        # of an effect outside the catalogue: names that say something true about it
        "accepted": [list(a) for a in (accepted if found.catalogue else accepted[1:])],
        "visible": None
        if binary
        else {
            "unit": unit,
            "before": _in_unit(before * noise, unit),
            "after": _in_unit(after * noise, unit),
            "ratio_to_noise": after,
        },
        "noncentrality": None if binary else z,
        "absorbed": (not binary) and z < ABSORBED,
    }


def _in_unit(value: float, unit: str) -> float:
    return value * 1e3 if unit in ("mm", "mrad") else value


def _ambient(scene: Scene, out: Simulated, dirt: float, dirt_z: float) -> list[dict[str, Any]]:
    """What is always there and may be named without being wrong."""
    found: list[dict[str, Any]] = [{"effect": "outliers", "location": "rows"}]
    if scene.case.kind != "motion" and dirt_z >= 2.0:
        found.append({"effect": "geometric_stiffness", "location": "arm", "ratio_to_noise": dirt})
    if scene.case.kind == "motion" and out.world.motion.motor_side:
        found += [{"effect": "joint_friction", "location": f"joint:{i}"} for i in range(1, 7)]
    return found


def _oracle(scene: Scene, table: Table, out: Simulated, unit: str, scale: Array) -> dict[str, float | str]:
    """r.m.s. of one coordinate of what no model can predict: noise of the channel and of the recorded load."""
    good = np.ones(len(table.clean), bool)
    good[table.outliers - 1] = False
    noise = table.noise
    if scene.case.kind == "deflection":
        p = scene.programme
        J, _, _ = jacobians(out.world, p.encoder[table.row[0]])
        soft = 1.0 / scene.true_stiffness()
        noise = noise - np.einsum("nci,i,ndi,nd->nc", J, soft, J, table.wrench_noise)[:, :3]
    noise = noise / scale if unit == "noise" else noise
    return {"unit": unit, "rmse": _in_unit(rms(noise[good]), unit), "rmse_with_outliers": _in_unit(rms(noise), unit)}
