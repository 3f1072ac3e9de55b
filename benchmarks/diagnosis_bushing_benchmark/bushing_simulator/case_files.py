"""Draw a case and write its cell, its recording and its truth."""

from __future__ import annotations

import copy
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from bushing_simulator.case_list import CasePlan
from bushing_simulator.cell_files import write_cell
from bushing_simulator.effect_draws import draw_effect
from bushing_simulator.effect_size import (
    EffectSize,
    compute_size,
    list_equivalent_bodies,
    list_equivalent_geometry,
    record_without_noise,
    scale_effect,
)
from bushing_simulator.laboratory import DrawnEffect, Laboratory
from bushing_simulator.load_recording import (
    LEVELS,
    LoadPlan,
    NoiseLevels,
    SensorErrors,
    add_load_noise,
    compute_load_response,
    draw_load_plan,
)
from bushing_simulator.outside_effects import list_outside_effects
from bushing_simulator.pose_recording import PoseNoise, PosePlan, add_pose_noise, draw_pose_plan
from bushing_simulator.record_faults import LOAD_FAULTS, POSE_FAULTS, Table
from bushing_simulator.reference_kinematics import compute_frames
from bushing_simulator.robot_assembly import HiddenPhysics
from bushing_simulator.robot_descriptions import ROBOTS, RobotDescription

ALWAYS_ALLOWED = (("geometric_stiffness", "arm"),)  # really there, in every recording


def draw_laboratory(robot: RobotDescription, rng: np.random.Generator) -> Laboratory:
    """Return a robot as built: springs ±15 % off nominal, masses ±5 % off the URDF, and nothing else."""
    springs = robot.springs * np.exp(rng.normal(0.0, 0.15, 6))
    masses = robot.masses * (1.0 + rng.uniform(-0.05, 0.05, 6))
    return Laboratory(HiddenPhysics(springs, masses, robot.tool_mass, robot.tool_center.copy()))


def draw_effects(case: CasePlan, robot: RobotDescription, rng: np.random.Generator) -> list[DrawnEffect]:
    """Return the hidden effects; two of the same kind get two places."""
    drawn: list[DrawnEffect] = []
    for name, _ in case.effects:
        if name.startswith("outside:"):
            drawn.append(list_outside_effects(case.kind)[int(name[8:])])
            continue
        for _attempt in range(50):
            effect = draw_effect(name, robot, rng, case.kind)
            if all((effect.effect, effect.location) != (d.effect, d.location) for d in drawn):
                break
        drawn.append(effect)
    return drawn


def write_case(case: CasePlan, folder: Path) -> dict:
    """Write ``cell/``, ``recording/`` and ``truth.json`` into a folder; return the truth."""
    rng = np.random.default_rng(case.seed)
    robot = ROBOTS[case.robot]
    lab = draw_laboratory(robot, rng)
    plan = (
        draw_load_plan(robot, rng, 14, bool(rng.random() < 0.4))
        if case.kind == "deflection"
        else draw_pose_plan(robot, rng, 48, bool(rng.random() < 0.6))
    )
    drawn = draw_effects(case, robot, rng)
    if case.kind == "absolute" and plan.fit:
        lab.errors["target_shift"] = rng.normal(0.0, 2e-4, plan.targets.shape)
    built, truth_effects = copy.deepcopy(lab), []
    plain = record_without_noise(robot, lab, plan)
    for effect, (_, ratio) in zip(drawn, case.effects, strict=True):
        size = scale_effect(robot, lab, plan, effect, ratio)
        effect.apply(built, size.scale)
        truth_effects.append(_state_effect(robot, lab, plan, effect, size, plain))
    record = record_without_noise(robot, built, plan)
    outlier_share = 0.006 if rng.random() < 0.3 else 0.0
    if isinstance(plan, LoadPlan):
        table, outliers = _build_load_table(robot, plan, record, outlier_share, rng)
    else:
        table, outliers = _build_pose_table(robot, plan, record, outlier_share, rng)
    fault_names = ()
    if case.fault:
        fault_names = (LOAD_FAULTS if case.kind == "deflection" else POSE_FAULTS)[case.fault](table, rng)
    truth = {
        "case": asdict(case),
        "effects": truth_effects,
        "fault_names": fault_names,
        "outlier_rows": outliers,
        "always_allowed": ALWAYS_ALLOWED + ((("outliers", "rows:*"),) if outliers else ()),
        "springs_true": lab.hidden.springs.tolist(),
        "springs_stated": robot.springs.tolist(),
        "residual_N": record.residual,
        "rest": asdict(
            compute_size(plain.mismatch, plain.base, plan, 0.0)
        ),  # without hidden effects, to the cell's model
        "job": _compute_job(robot, built, rng),
    }
    write_cell(robot, folder / "cell", _has_compensator(drawn))
    _write_recording(case, robot, plan, table, folder / "recording")
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    return truth


def _has_compensator(drawn: list[DrawnEffect]) -> str:
    return "fitted" if any(d.effect == "gravity_compensator" for d in drawn) else "unknown"


def _state_effect(
    robot: RobotDescription,
    lab: Laboratory,
    plan: LoadPlan | PosePlan,
    effect: DrawnEffect,
    size: EffectSize,
    plain: object,
) -> dict:
    accepted = list(effect.accepted)
    beyond_joint_6 = [("link_compliance", "link:6"), ("tool_compliance", "tool")]  # one frame, loaded at the TCP only
    if (effect.effect, effect.location) in beyond_joint_6:
        accepted += beyond_joint_6
    loads = isinstance(plan, LoadPlan)
    if effect.effect.endswith(("compliance", "coupling", "compensator") if loads else ("offset", "geometry")):
        changed = copy.deepcopy(lab)
        shrink = min(1.0, 0.5 / size.ratio)  # the linear part: what the columns of a catalogue can equal
        effect.apply(changed, size.scale * shrink)
        record = record_without_noise(robot, changed, plan)
        find_rivals = list_equivalent_bodies if loads else list_equivalent_geometry
        accepted += find_rivals(robot, plan, (record.mismatch - plain.mismatch) / shrink, record)
    return {
        "effect": effect.effect,
        "location": effect.location,
        "law": effect.law,
        "size": asdict(size),
        "parameters": effect.truth(size.scale),
        "accepted": sorted(set(accepted) | {(effect.effect, effect.location)}),
    }


def _build_load_table(
    robot: RobotDescription, plan: LoadPlan, record, outlier_share: float, rng: np.random.Generator
) -> tuple[Table, list[int]]:
    noise = NoiseLevels(outlier_share=outlier_share)
    seen, force, wrong = add_load_noise(robot, plan, record.readings, record.force, noise, rng)
    cycles, levels = len(plan.q), len(LEVELS)
    repeat = lambda x: np.repeat(x, levels, axis=0)  # noqa: E731
    start = np.cumsum(np.r_[0.0, plan.durations.sum(1)[:-1] + 120.0])
    table: Table = {
        "pose": repeat(plan.pose + 1),
        "cycle": repeat(np.arange(1, cycles + 1)),
        "session": repeat(plan.session + 1),
        "time_s": (start[:, None] + np.cumsum(plan.durations, axis=1)).ravel(),
        **{f"q{i + 1}_deg": repeat(np.rad2deg(plan.q[:, i])) for i in range(6)},
        **{f"f{a}_N": force[..., i].ravel() for i, a in enumerate("xyz")},
        **{f"d{a}_mm": 1e3 * seen[..., i].ravel() for i, a in enumerate("xyz")},
    }
    if plan.rotations:
        table.update({f"r{a}_mrad": 1e3 * seen[..., 3 + i].ravel() for i, a in enumerate("xyz")})
    return table, [c * levels + k + 1 for c, k in wrong]


def _build_pose_table(
    robot: RobotDescription, plan: PosePlan, record, outlier_share: float, rng: np.random.Generator
) -> tuple[Table, list[int]]:
    noise = PoseNoise(outlier_share=outlier_share)
    seen, wrong = add_pose_noise(plan, record.readings, noise, rng)
    visits, count = seen.shape[:2]
    flange = compute_frames(robot, plan.q)[1][:, 6]
    if plan.fit:
        flange = plan.tracker[0].T @ flange
    repeat = lambda x: np.repeat(x, count, axis=0)  # noqa: E731
    table: Table = {
        "pose": repeat(plan.pose + 1),
        "cycle": repeat(np.arange(1, visits + 1)),
        "session": repeat(plan.session + 1),
        "time_s": repeat(plan.time + 40000.0 * plan.session),
        "temperature_C": repeat(record.gauge + rng.normal(0.0, 0.05, visits)),
        **{f"q{i + 1}_deg": repeat(np.rad2deg(plan.q[:, i])) for i in range(6)},
        **{f"{a}_mm": 1e3 * seen[..., i].ravel() for i, a in enumerate("xyz")},
        "target": np.tile(np.arange(1, count + 1), visits),
        "_flange": repeat(flange),
    }
    return table, [v * count + t + 1 for v, t in wrong]


def _write_recording(
    case: CasePlan, robot: RobotDescription, plan: LoadPlan | PosePlan, table: Table, folder: Path
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["machopt_recording: 1", f"kind: {case.kind}", "data: data.csv"]
    if isinstance(plan, LoadPlan):
        lines += ["wrench_frame: base", "displacement_frame: base"]
        lines.append(
            "standard_uncertainty: {displacement_mm: 0.014, rotation_mrad: 0.025, "
            f"force_N: {2 + 0.0025 * robot.pull:.1f}}}"
        )
        columns = list(table)
    else:
        lines.append(f"registration: {'fit' if plan.fit else 'fixed'}")
        columns = [c for c in table if c != "_flange" and (plan.fit or c != "target")]
        if plan.fit:
            places = "; ".join(", ".join(f"{1e3 * x:.3f}" for x in t) for t in plan.targets)
            stated = ", ".join(f"{n + 1}: [{t}]" for n, t in enumerate(places.split("; ")))
            lines.append(f"targets_mm: {{{stated}}}")
            lines.append("standard_uncertainty: {displacement_mm: 0.021, target_mm: 0.3}")
        else:
            lines.append("standard_uncertainty: {displacement_mm: 0.021}")
    (folder / "recording.yaml").write_text("\n".join(lines) + "\n")
    labels = {"pose", "cycle", "session", "target"}
    rows = [",".join(columns)]
    for n in range(len(table["pose"])):
        rows.append(",".join(f"{table[c][n]:d}" if c in labels else f"{table[c][n]:.6f}" for c in columns))
    (folder / "data.csv").write_text("\n".join(rows) + "\n")


def _compute_job(robot: RobotDescription, built: Laboratory, rng: np.random.Generator) -> dict:
    """Return four job poses with their pulls and the true deflection of the first step of a load, in mm."""
    plan = draw_load_plan(robot, rng, 4, False)
    moved, forces, _ = compute_load_response(robot, copy.deepcopy(built.hidden), plan, SensorErrors())
    first = np.flatnonzero(plan.session == 0)
    return {
        "q_deg": np.rad2deg(plan.q[first]).round(4).tolist(),
        "force_N": forces[first, 2].round(3).tolist(),
        "deflection_mm": (1e3 * moved[first, 2, :3]).round(5).tolist(),
    }
