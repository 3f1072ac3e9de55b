"""What may be concealed in a load test: changes of the arm, of the load that really acts, of what is written down."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import body_compliance
import dual_quaternions as dq
import elastic_arm
import gear_models
import numpy as np
from dual_quaternions import Array
from effect_strength import Effect
from loading_rig import Rig

ARCMIN = np.pi / 10800
WHOLE_ARM = ("joint_nonlinear_stiffness", "joint_backlash", "joint_hysteresis", "joint_creep")


def draw(name: str, scene: Rig, rng: np.random.Generator, loud: float) -> list[Effect]:
    """Candidates of an effect at its places, in random order; the first that can be made loud enough is taken."""
    joints = [int(j) for j in rng.permutation(6) if scene.swing[j] > 0.12 * np.max(scene.swing)]
    memory = str(rng.choice(["kept", "wound", "cycle"]))
    out: list[Effect] = []
    if name == "joint_nonlinear_stiffness":
        for j in joints:
            out.append(Effect(name, f"joint:{j + 1}", 0.5, 2.0, detail={"joint": j, "knee": 0.18 * scene.swing[j]}))
    elif name == "joint_backlash":
        for j in joints:
            # only where the weights let the torque change sign
            torque = scene.torque[:, j]
            if min(np.mean(torque > 0), np.mean(torque < 0)) > 0.1:
                out.append(_play(name, j, drag=0.015 * scene.swing[j]))
    elif name == "joint_hysteresis":
        law = str(rng.choice(["dahl", "preisach"]))
        for j in joints:
            detail = {"reach": 0.3 * scene.swing[j], "memory": memory, "law": law}
            one = _play(name, j, **detail)
            if law == "preisach" and memory != "cycle":  # its loops differ by the weight that it bears: no one width
                one = replace(one, unit="", parameter="")
            else:
                opened = gear_models.opening(_remembers(1.0, j, detail, scene), 0.5 * scene.swing[j])
                one = replace(one, factor=one.factor * opened)
            out.append(one)
    elif name == "joint_creep":
        out = [Effect(name, f"joint:{j + 1}", 0.05, 0.25, detail={"joint": j}) for j in joints]
    elif name == "joint_pose_dependent_stiffness":
        for j in joints:
            centre = float(scene.nominal.home[j] + rng.uniform(-0.4, 0.4) * np.ptp(scene.script.q[:, j]) / 2)
            out.append(
                Effect(name, f"joint:{j + 1}", 0.3, 1.2, detail={"joint": j, "centre": centre, "narrow": _narrow(j)})
            )
    elif name == "joint_coupling":
        for a, b in ((3, 4), (4, 5), (3, 5)):
            c = float(np.sqrt(1 / scene.built.stiffness[a] / scene.built.stiffness[b]))
            detail = {"joints": (a, b), "scale": c}
            one = Effect(name, f"joint:{a + 1}-{b + 1}", 0.2, 0.7, "µrad/(N·m)", 1e6 * c, "compliance", detail=detail)
            out.append(one)
    elif name == "link_compliance":
        for i in rng.permutation([0, 1, 2, 3]):
            if np.linalg.norm(scene.built.ends()[i, :3]) < 0.01:  # axes that meet: nothing to bend
                continue
            out.append(
                Effect(name, f"link:{i + 1}", 0.3, 1.5, detail={"link": int(i), "taper": rng.uniform(0.55, 0.85)})
            )
    elif name == "base_compliance":
        uneven = tuple(float(u) for u in rng.uniform(0.6, 1.6, 3))
        out.append(Effect(name, "base", 0.3, 1.5, detail={"uneven": uneven, "foot": -1}))
    elif name == "tool_compliance":
        out.append(Effect(name, "tool", 0.3, 3.0, accepted=(("link_compliance", "link:6"),), detail={}))
    elif name in ("force_sensor_offset", "force_sensor_gain", "force_sensor_frame", "load_geometry"):
        axis = int(rng.integers(3))
        across = rng.normal(size=3)
        across /= np.linalg.norm(across)
        unit, factor, cap, start, parameter, other = {
            "force_sensor_offset": ("N", scene.largest, 0.15, 0.05, "offset", ()),
            "force_sensor_gain": ("1", 1.0, 0.3, 0.05, "gain", ()),
            "force_sensor_frame": ("deg", 180 / np.pi, 0.25, 0.05, "angle", (("load_geometry", "sensor:force"),)),
            "load_geometry": ("mm", 1e3, 0.12, 0.02, "", (("force_sensor_frame", "sensor:force"),)),
        }[name]
        if name == "load_geometry":
            other = ()
        detail: dict[str, Any] = {"axis": axis, "across": across}
        out.append(Effect(name, "sensor:force", start, cap, unit, factor, parameter, other, detail))
    elif name == "displacement_frame":
        across = rng.normal(size=3)
        detail = {"across": across / np.linalg.norm(across)}
        out.append(Effect(name, "sensor:displacement", 0.02, 0.2, "deg", 180 / np.pi, "angle", detail=detail))
    elif name == "thermal_drift":
        out.append(Effect(name, "environment", 1e-4, 1e-2, detail={"tau": (600.0, 5000.0), "way": rng.normal(size=3)}))
    else:
        out = outside(name, scene, rng)
    for one in out:
        one.loudness = loud
    return out


def outside(name: str, scene: Rig, rng: np.random.Generator) -> list[Effect]:
    """Physics that no catalogue of ours holds; what may still be said of it stands in ``accepted``."""
    body = (("base_compliance", "base"),)
    if name == "loose_foot":
        uneven = (1.0, 1.0, 1.0)
        detail = {"uneven": uneven, "foot": int(rng.integers(3)), "gap": 2e-3}
        return [Effect("unnamed", "base", 0.3, 1.5, accepted=body, detail=detail)]
    if name == "nested_reflector":  # the ball jumps in its nest by the load's direction, beyond a threshold
        return [Effect("unnamed", "sensor:displacement", 4e-5, 2e-4, detail={"way": rng.normal(size=3)})]
    if name == "hose":  # a pressurised hose, a spring from the base to the flange that only pulls
        return [Effect("unnamed", "arm", 0.05, 0.5, detail={"post": rng.normal(0, 0.6, 3) + np.array([0.0, 0.0, 1.8])})]
    if name == "bent_amplifier":  # the load cell's straight line is none
        return [Effect("unnamed", "sensor:force", 0.05, 0.3, accepted=_sensor(), detail={"axis": int(rng.integers(3))})]
    if name == "slipping_flange":  # sticks, then slips beyond a force, and stays until the cycle ends
        return [Effect("unnamed", "tool", 5e-5, 5e-4, detail={})]
    if name == "leaning_floor":  # the slab sinks in with the days: the tracker stands on it as well
        return [Effect("unnamed", "sensor:displacement", 3e-5, 5e-4, detail={})]
    raise ValueError(f"{name}: no such effect of a load test")


def _sensor() -> tuple[tuple[str, str], ...]:
    return tuple((f"force_sensor_{n}", "sensor:force") for n in ("gain", "offset", "frame"))


def _play(name: str, joint: int, **detail: Any) -> Effect:
    """Sizes are widths in arcmin."""
    return Effect(
        name, f"joint:{joint + 1}", ARCMIN, 4 * ARCMIN, "arcmin", 1 / ARCMIN, "width", (), {"joint": joint, **detail}
    )


def _remembers(width: float, joint: int, detail: dict[str, Any], scene: Rig) -> elastic_arm.Gear:
    """A gear whose loop is ``width`` rad wide under torques that know no end."""
    reach, memory = detail["reach"], detail["memory"]
    if detail["law"] == "dahl":
        return gear_models.dahl(width, reach, memory)
    largest = 0.6 * float(np.max(np.abs(scene.torque[:, joint])) if memory != "cycle" else scene.swing[joint])
    return gear_models.preisach(width, max(largest, 1.5 * reach), memory)


def _narrow(joint: int) -> float:
    return 6.0 if joint in (1, 2, 4) else 2.0


def applied(effects: list[Effect], scene: Rig) -> tuple[elastic_arm.ElasticArm, elastic_arm.Script]:
    """The arm and the loads with all of this in them."""
    build, script = elastic_arm.ElasticArm(scene.built), scene.script
    for e in effects:
        _one(e, build, scene)
        if e.effect == "load_geometry":
            off = np.zeros((len(script.q), 3))
            off[:] = e.amplitude * e.detail["across"]
            tips = elastic_arm.chain(
                elastic_arm.ElasticArm(scene.nominal), script.q, {"joints": np.zeros_like(script.q)}
            )["tcp"]
            lever = np.einsum("nij,nj->ni", dq.matrix(tips), off)
            load = script.wrench.copy()
            load[:, 3:] += np.cross(lever, load[:, :3])
            script = replace(script, wrench=load)
    return build, script


def _one(e: Effect, build: elastic_arm.ElasticArm, scene: Rig) -> None:
    a, d, soft = e.amplitude, e.detail, 1.0 / scene.built.stiffness
    j = d.get("joint", 0)
    if e.effect == "joint_nonlinear_stiffness":
        build.gears.append((j, gear_models.soft_start(a * soft[j], d["knee"])))
    elif e.effect == "joint_backlash":
        build.gears.append((j, gear_models.clearance(a, d["drag"])))
    elif e.effect == "joint_hysteresis":
        build.gears.append((j, _remembers(a, j, d, scene)))
    elif e.effect == "joint_creep":
        build.gears.append((j, gear_models.slow(a, soft[j])))
    elif e.effect == "joint_pose_dependent_stiffness":
        build.gears.append((j, gear_models.sector(a * soft[j], d["centre"], d["narrow"], j)))
    elif e.effect == "joint_coupling":
        p, q = d["joints"]
        build.cross = build.cross.copy()
        build.cross[p, q] = build.cross[q, p] = a * d["scale"]
    elif e.effect == "link_compliance":
        i = d["link"]
        span = scene.built.ends()[i, :3]
        # the beam's end turns as much as the joint beside it would by ``a``
        EI = np.linalg.norm(span) * scene.built.stiffness[max(i, 1)] / a
        build.links[i] = body_compliance.beam(span, float(EI), d["taper"], flat=1.3)
    elif e.effect == "base_compliance" or (e.effect == "unnamed" and e.location == "base"):
        radius = 0.16 * scene.built.reach()
        axial = float(scene.built.stiffness[1]) / (a * 1.5 * radius**2)
        at, k = body_compliance.feet(radius, axial, 3.0 * axial, d["uneven"])
        if d["foot"] >= 0:
            build.base = lambda w: body_compliance.loose(at, k, w, d["foot"], d["gap"])
        else:
            C = np.linalg.inv(body_compliance.plate(at, k))
            build.base = lambda w: w @ C.T
    elif e.effect == "tool_compliance":
        along = scene.built.tcp[:3]
        length = float(np.linalg.norm(along))
        EI = length * float(scene.built.stiffness[4]) / (0.6 * a)
        build.tool = body_compliance.stepped(length, along, EI)
    elif e.effect == "unnamed" and e.location == "arm":
        post, k = d["post"], a * float(scene.built.stiffness[1]) / scene.built.reach() ** 2

        def hose(frames: dict[str, Array]) -> tuple[Array, Array]:
            at = dq.place(frames["flange"])
            pull = post - at
            long = np.linalg.norm(pull, axis=1, keepdims=True)
            force = k * np.maximum(long - 0.55 * scene.built.reach(), 0.0) * pull / long
            return force, np.cross(at, force)

        build.extra_wrench = hose


def record_changes(
    effects: list[Effect], scene: Rig, wrench: Array, moved: Array, turned: Array
) -> tuple[Array, Array, Array]:
    """What the instruments make of load and motion (base axes in, base axes out)."""
    # an instrument errs in the axes it is read in: those the recording names
    R, S = axes_of(scene, scene.lab.wrench_frame), axes_of(scene, scene.lab.displacement_frame)
    keep = scene.shown
    cycles = scene.script.cycle[keep]
    for e in effects:
        a, d = e.amplitude, e.detail
        force = np.einsum("nji,nj->ni", R, wrench[:, :3])
        if e.effect == "force_sensor_offset":
            force = force + a * scene.largest * np.eye(3)[d["axis"]]
        elif e.effect == "force_sensor_gain":
            force = force * (1.0 + a * np.eye(3)[d["axis"]])
        elif e.effect == "force_sensor_frame":
            force = force @ dq.matrix(dq.turned(a * d["across"]))
        elif e.effect == "unnamed" and e.location == "sensor:force":
            one = np.eye(3)[d["axis"]]
            force = force + a * force**2 / scene.largest * one
        wrench = np.concatenate([np.einsum("nij,nj->ni", R, force), wrench[:, 3:]], axis=1)
        if e.effect == "displacement_frame":
            turn = dq.matrix(dq.turned(a * d["across"]))
            moved, turned = (np.einsum("nij,jk,nlk,nl->ni", S, turn, S, x) for x in (moved, turned))
        if e.effect == "thermal_drift":
            moved = moved + a * _heat(scene.script.time, scene, d["tau"])[keep, None] * d["way"]
        if e.effect == "unnamed" and e.location == "sensor:displacement":
            share = np.linalg.norm(wrench[:, :3], axis=1) / scene.largest
            if "way" in d:
                sign = np.sign(wrench[:, :3] @ np.array([0.36, 0.48, 0.8]))
                moved = moved + a * ((share > 0.6) * sign)[:, None] * d["way"]
            else:
                moved = moved + a * np.array([0, 0, -1.0]) * (share * scene.script.session[keep] * share)[:, None]
        if e.effect == "unnamed" and e.location == "tool":
            slipped = _slip(wrench[:, :3], cycles, 0.7 * scene.largest)
            moved = moved + a * slipped
    return wrench, moved, turned


def axes_of(scene: Rig, name: str) -> Array:
    """(N, 3, 3) columns: axes of the rows shown that a recording calls ``base`` or ``tool``."""
    if name == "tool":
        return dq.matrix(scene.rigid["tcp"])
    return np.broadcast_to(np.eye(3), (int(scene.shown.sum()), 3, 3)).copy()


def _heat(time: Array, scene: Rig, tau: tuple[float, float]) -> Array:
    """(N,) a lumped network of two masses warmed by work since the session began, minus what it was at the zero."""
    first = np.zeros_like(time)
    for s in np.unique(scene.script.session):
        mine = scene.script.session == s
        t = time[mine] - time[mine][0]
        hot, cold = tau
        first[mine] = 1.0 - (cold * np.exp(-t / cold) - hot * np.exp(-t / hot)) / (cold - hot)
    return np.asarray(first - first[scene.zero])


def _slip(force: Array, cycles: Array, limit: float) -> Array:
    """(N, 3) unit slip along the force since it first exceeded ``limit`` in the cycle."""
    out = np.zeros_like(force)
    for c in np.unique(cycles):
        rows = np.flatnonzero(cycles == c)
        over = np.flatnonzero(np.linalg.norm(force[rows], axis=1) > limit)
        if len(over):
            k = rows[over[0]]
            out[rows[over[0] :]] = force[k] / np.linalg.norm(force[k])
    return out
