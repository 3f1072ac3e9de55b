"""A measurement plan as tables, plan.json and page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import machopt
from machopt.design.candidates import PosePool
from machopt.design.loadcases import LoadCases
from machopt.design.loads import LoadWay
from machopt.design.maximin import LEVEL, POWER, needed_noncentrality
from machopt.design.measurement import UNLOADED_TWICE, ReadingNoise
from machopt.design.poseplan import MOST_POSES, Comparison, PosePlan
from machopt.diagnose.apart.disputes import Stand
from machopt.diagnose.apart.predicted import HOLD
from machopt.diagnose.apart.separate import Discriminating, described
from machopt.domain.cell import Cell
from machopt.domain.recording import Recording, StandardUncertainty
from machopt.domain.results.poses import PosesResult
from machopt.formats.poses import PosesTable
from machopt.model.collision import LONGEST, CollisionModel
from machopt.model.robot import Robot
from machopt.output.jsonfile import plain
from machopt.report import poses_page as page
from machopt.services.poses_request import Request, shown

Array = NDArray[np.float64]

CLOUD = 600  # candidates drawn on the page
BETWEEN = 60.0  # s between load cycles in the template
SOURCES = {
    "random": "any pose that can be reached and loaded",
    "dumas2011": "zones of good dexterity with low ν_p",
    "zhang2025": "KCI above 0.45",
    "jiao2022": "corners and centre of a cube, ±10°",
}


def poses_table(
    plan: PosePlan,
    pool: PosePool,
    ways: Sequence[LoadWay],
    collision: CollisionModel | None,
    home: Array,
    noise: ReadingNoise,
) -> PosesTable:
    """One row a load cycle, in the order of work."""
    cases = plan.cases
    reading = np.array([v.reading for v in plan.visits])
    poses = cases.pose[reading]
    q = pool.q[poses]
    distinct, back = np.unique(poses, return_inverse=True)
    clearance, free = np.full(len(distinct), np.nan), [None] * len(reading)
    way_free: list[bool | None] = list(free)
    if collision is not None:
        cut = np.zeros(len(distinct), bool)
        clearance = collision.nearest(pool.q[distinct], cut).distance
        driven = np.concatenate([home[None], q])
        hit = collision.check_motion(driven, np.zeros(len(driven), bool), LONGEST).hit
        way_free = [not h for h in hit[1:].tolist()]
    return PosesTable(
        pose=np.array([v.pose + 1 for v in plan.visits]),
        cycle=np.array([v.cycle + 1 for v in plan.visits]),
        session=np.array([v.round + 1 for v in plan.visits]),
        q=q,
        load=tuple(ways[cases.way[n]].describe(cases.magnitude[n]) for n in reading),
        wrench=cases.wrench[reading],
        position=pool.T_base_tcp[poses, :3, 3],
        displacement=cases.twist[reading, : noise.dimensions],
        kci=pool.kci[poses],
        nu_p=cases.nu_p[reading],
        nu_r=cases.nu_r[reading],
        clearance=clearance[back],
        load_point=cases.point[reading],
        way_free=tuple(way_free),
    )


def stepped(table: PosesTable, steps: Sequence[float]) -> PosesTable:
    """Each load cycle as its readings: up to the full load and back."""
    K = len(steps)
    if K == 1:
        return table
    factor = np.tile(np.array(steps), len(table))
    load = tuple(_share_of(f, words) for words in table.load for f in steps)
    spread = {name: np.repeat(value, K, axis=0) for name, value in vars(table).items() if isinstance(value, np.ndarray)}
    first = np.arange(len(factor)) % K == 0
    way_free = tuple(
        free if head else True
        for free, head in zip(np.repeat(np.array(table.way_free, object), K).tolist(), first.tolist(), strict=True)
    )
    return PosesTable(
        **{
            **spread,
            "load": load,
            "way_free": way_free,
            "wrench": spread["wrench"] * factor[:, None],
            "displacement": spread["displacement"] * factor[:, None],
        }
    )


def _share_of(factor: float, words: str) -> str:
    if factor == 0.0:
        return "unloaded"
    return words if factor == 1.0 else f"{100 * factor:.0f} % of {words}"


def template_of(
    table: PosesTable, plan: PosePlan, noise: ReadingNoise, request: Request, steps: Sequence[float] = ()
) -> Recording:
    """The recording the measurements go into; its displacements are still zero.

    Args:
        steps: shares of the full load that the rows of a load cycle pass through; empty: each row is a cycle.
    """
    own = float(np.sqrt(noise.reading**2 - noise.pose**2))
    force = np.linalg.norm(table.wrench[:, :3], axis=1)
    return Recording(
        kind="deflection",
        source="recording_template",
        q=table.q,
        pose=table.pose,
        cycle=table.cycle,
        session=table.session,
        line=np.arange(2, len(table) + 2),
        wrench=table.wrench,
        displacement=np.zeros_like(table.displacement),
        **_in_steps(table, steps),
        uncertainty=StandardUncertainty(
            displacement=own,
            rotation=None if noise.targets is None else own / noise.targets,
            force=float(noise.force * np.sqrt(np.mean(force**2))) or None,
        ),
        notes=(
            "Each cycle: read the unloaded TCP, load step by step and unload step by step, hold each step as time_s "
            "says and read; enter each reading minus the unloaded one at the start of its cycle, in base_link axes at "
            "the TCP. Replace joints, loads and times by what was really set."
            if len(steps) > 1
            else "Each row: read the unloaded TCP, load, read, unload, read; enter loaded minus the mean of the two "
            "unloaded readings, in base_link axes at the TCP. Replace joints and loads by what was really set."
        ),
        labelled=frozenset({"pose", "cycle", "session"}),
    )


def _in_steps(table: PosesTable, steps: Sequence[float]) -> dict[str, Any]:
    """Branch and time of each reading of stepped cycles."""
    K = len(steps)
    if K < 2:
        return {}
    rising = np.arange(K) <= int(np.argmax(np.array(steps)))
    cycles = len(table) // K
    time = np.repeat(np.arange(cycles) * (K * HOLD + BETWEEN), K) + HOLD * np.tile(np.arange(1, K + 1), cycles)
    return {"branch": np.tile(np.where(rising, 1, -1), cycles).astype(np.int8), "time": time.astype(float)}


def cautions(
    request: Request,
    pool: PosePool,
    cases: LoadCases,
    plan: PosePlan | None,
    noise: ReadingNoise,
    ways: Sequence[LoadWay],
) -> tuple[str, ...]:
    """What the user should know before measuring."""
    out = []
    if plan is None:
        return (why_nothing(request, pool, cases, noise, ways),)
    if len(pool) < request.candidates:
        out.append(f"only {len(pool)} candidate poses of {request.candidates} were found in {pool.tried} tried")
    if len(plan.design.blocks) < request.poses:
        out.append(f"only {len(plan.design.blocks)} poses can be loaded; {request.poses} were asked for")
    names = plan.unknowns.names
    for group in plan.found.unseen:
        words = ", ".join(names[p] for p in group)
        if len(group) > 1:
            out.append(f"{words} appear only together in these readings and cannot be told apart")
        else:
            kinds = {w.kind for w in ways}
            hint = "a horizontal pull" if kinds == {"weight"} else "a load on an arm (--arms-mm)"
            out.append(f"{words} is not seen by any of these loads; {hint} may show it")
    if (
        request.discriminate is None
        and request.target_percent is not None
        and plan.needed is None
        and plan.judged.any()
    ):
        worst = names[int(np.argmax(np.where(plan.judged, plan.found.sigma, -np.inf)))]
        out.append(
            f"{request.target_percent:g} % of every joint is out of reach with {MOST_POSES} poses of these loads; "
            f"{worst} is the worst"
        )
    if request.max_load_N is None:
        out.append("no rated load was given (--max-load-N): check each load against the robot's load diagram")
    return tuple(out)


_HELP = {
    "TCP too low": "--floor-mm",
    "TCP too high": "--ceiling-mm",
    "TCP outside the box": "--box-mm",
    "too far from the tracker": "--tracker-range-mm",
    "hidden from the tracker": "--tracker-angle-deg",
    "KCI too low": "--min-kci",
    "collision or too little clearance": "--clearance-mm or --without-workpiece",
}


def why_nothing(
    request: Request, pool: PosePool, cases: LoadCases, noise: ReadingNoise, ways: Sequence[LoadWay]
) -> str:
    """One sentence: what stands in the way of any load test, and what would help."""
    if not len(pool):
        # each pose counts where it fails first, so the last reason is what all that came so far fail for
        left = list(pool.rejected)[-1]
        most = max(pool.rejected, key=lambda reason: pool.rejected[reason])
        told = [f"all {pool.rejected[left]:,} that come so far fail for {left!r}, see {_HELP[left]}"]
        if most != left:
            told.insert(0, f"{pool.rejected[most]:,} fail for {most!r}, see {_HELP[most]}")
        return f"none of {pool.tried:,} poses passes; {'; '.join(told)}"
    reason, count = max(cases.rejected.items(), key=lambda item: item[1])
    least = 1e3 * request.min_signal * noise.reading * request.prior_factor
    least_load = min(way.magnitudes[0] for way in ways)
    help_ = {
        "rope too short": "anchors farther from the TCP would work",
        "load above the limit": f"smaller loads, or a --max-load-N of {least_load:.4g} and more, would work",
        "deflection above the limit": f"smaller loads, or a --max-deflection-mm above {request.max_deflection_mm:g}, "
        "would work",
        "joint torque above the limit": "smaller loads or shorter --arms-mm would work",
        "K_C matters too much": "smaller loads, or larger --max-nu-p and --max-nu-r-deg, would work",
        "too small to measure": f"larger loads would work: every one moves the TCP by less than {least:.3f} mm "
        "(--min-signal times the reading's uncertainty)",
    }[reason]
    return f"no load is admissible at any of {len(pool)} poses; {count} pose × load pairs fail for {reason!r}: {help_}"


def result_of(
    request: Request,
    cell: Cell,
    pool: PosePool,
    cases: LoadCases,
    plan: PosePlan | None,
    noise: ReadingNoise,
    warnings: Sequence[str],
    hashes: dict[str, str],
    length: float,
    ways: Sequence[LoadWay],
    apart: Discriminating | None = None,
) -> PosesResult:
    """plan.json; relative uncertainties are shares of the prior value."""
    head: dict[str, object] = {
        "machopt_poses": 1,
        "version": machopt.__version__,
        "verdict": "done" if plan is not None else "infeasible",
        "inputs": hashes,
        "options": dict(shown(request)),
        "cell": cell.name,
        "characteristic_length_mm": length * 1e3,
        "reading_uncertainty_mm": noise.reading * 1e3,
        "candidates": {"poses": len(pool), "tried": pool.tried, "rejected": pool.rejected},
        "load_cases": {"ways": len(ways), "admissible": len(cases), "rejected": cases.rejected},
        "warnings": list(warnings),
    }
    if plan is None:
        return PosesResult.model_validate(plain(head))
    u, found = plan.unknowns, plan.found
    poses, readings = len(plan.design.blocks), len(plan.design.readings)
    worst = [a.worst(plan.judged) for a in plan.believed]
    return PosesResult.model_validate(
        plain(
            head
            | {
                "poses": poses,
                "readings": len(plan.visits) * (1 if apart is None else len(apart.steps)),
                "load_cases_chosen": readings,
                "unknowns": [
                    {
                        "name": n,
                        "unit": unit,
                        "scale": s,
                        "relative": r,
                        "standard_uncertainty": e,
                        "seen": bool(np.isfinite(e)),
                    }
                    for n, unit, s, r, e in zip(
                        u.names, u.units, u.scale.tolist(), u.relative.tolist(), found.sigma.tolist(), strict=True
                    )
                ],
                "not_told_apart": [[u.names[p] for p in group] for group in found.unseen],
                "design": {
                    "condition_number": found.condition,
                    "rms": found.rms(plan.judged),
                    "worst": found.worst(plan.judged),
                    "log_det": plan.design.value,
                    "d_efficiency_at_least": plan.bound,
                    "worst_if_prior_wrong": worst,
                },
                "target": None
                if request.target_percent is None
                else {
                    "percent": request.target_percent,
                    "poses": plan.needed,
                    "readings": None if plan.needed is None else plan.needed * request.loads * request.cycles,
                },
                "curve": {"poses": list(plan.curve_poses), "rms": list(plan.curve)},
                "heuristics": [_comparison(c) for c in plan.comparisons],
                "order": [{"pose": v.pose + 1, "cycle": v.cycle + 1, "session": v.round + 1} for v in plan.visits],
            }
            | ({} if apart is None else {"discriminate": _apart(apart)})
        )
    )


def _apart(a: Discriminating) -> dict[str, object]:
    enough = needed_noncentrality()
    return {
        "level": LEVEL,
        "power": POWER,
        "noncentrality_needed": enough,
        "noise_mm": {"own": a.noise.displacement * UNLOADED_TWICE**0.5 * 1e3, "pose": a.noise.pose * 1e3},
        "steps": list(a.steps),
        "cycles": a.noise.cycles,
        "least_noncentrality_per_cycle": a.least,
        "random_least_noncentrality_per_cycle": a.random,
        "pairs": [
            {
                "one": _stand(p.one),
                "two": _stand(p.two),
                "words": described(p),
                "why": p.why,
                "noncentrality_per_cycle": p.per_cycle,
                "noncentrality_planned": p.planned,
                "cycles_for_power": p.cycles,
                "cycles_until_diagnose_excludes": p.until,
                "random_noncentrality_per_cycle": p.random,
                "told_apart": p.planned >= enough,
                "otherwise": p.advice or None,
            }
            for p in a.pairs
        ],
    }


def _stand(s: Stand) -> dict[str, object]:
    return {"effect": s.effect, "location": s.location, "law": s.law}


def _comparison(c: Comparison) -> dict[str, object]:
    return {
        "name": c.name,
        "poses": c.poses,
        "rms_10_50_90": list(c.rms),
        "standard_uncertainty": c.sigma.tolist(),
        "d_efficiency": c.efficiency[0],
        "a_efficiency": c.efficiency[1],
        "e_efficiency": c.efficiency[2],
        "readings_for_the_same": c.readings,
        "curve_rms": list(c.curve),
    }


def page_of(
    request: Request,
    cell: Cell,
    robot: Robot,
    pool: PosePool,
    cases: LoadCases,
    plan: PosePlan | None,
    table: PosesTable | None,
    hashes: dict[str, str],
    warnings: Sequence[str],
    apart: Discriminating | None = None,
) -> page.PosesPage:
    """Everything the page shows."""
    common: dict[str, Any] = {
        "title": f"{'Load tests' if apart is None else 'Next measurement'} for {cell.name}",
        "cell": cell.name,
        "version": machopt.__version__,
        "tried": pool.tried,
        "passed": len(pool),
        "cases": len(cases),
        "rejected_poses": tuple(pool.rejected.items()),
        "rejected_loads": tuple(cases.rejected.items()),
        "warnings": tuple(warnings),
        "options": tuple(shown(request)),
        "hashes": tuple(hashes.items()),
    }
    if plan is None or table is None:
        return page.PosesPage(**common, reason=warnings[-1])
    u = plan.unknowns
    chosen = pool.q[plan.cases.pose[[b[0] for b in plan.design.blocks]]]
    heuristics = tuple(
        page.Heuristic(c.name, SOURCES[c.name], c.poses, c.sigma, c.rms, c.efficiency, c.readings, np.array(c.curve))
        for c in plan.comparisons
    )
    rows = (
        ()
        if apart is None
        else tuple(
            page.Apart(described(p), p.why, p.per_cycle, p.planned, p.cycles, p.until, p.random, p.advice)
            for p in apart.pairs
        )
    )
    return page.PosesPage(
        **common,
        apart=rows,
        rounds=0 if apart is None else apart.noise.cycles,
        enough=needed_noncentrality(),
        unknowns=u.names,
        relative=u.relative,
        sigma=plan.found.sigma,
        rms=plan.found.rms(plan.judged),
        condition=plan.found.condition,
        bound=plan.bound,
        poses=len(chosen),
        readings=len(table),
        per_pose=request.loads * len(plan.visits) // max(len(plan.design.readings), 1),
        heuristics=heuristics,
        curve_poses=plan.curve_poses,
        curve=np.array(plan.curve),
        target=_share(request.target_percent),
        needed=plan.needed,
        cloud=pool.T_base_tcp[:CLOUD, :3, 3],
        arms=_arm_points(robot, chosen, cell),
        work=page.Work(
            table.session,
            table.pose,
            table.cycle,
            table.q,
            table.load,
            np.linalg.norm(table.displacement[:, :3], axis=1),
            table.kci,
            table.nu_p,
            table.clearance,
            table.way_free,
        ),
    )


def _share(percent: float | None) -> float:
    return float("nan") if percent is None else percent / 100


def _arm_points(robot: Robot, q: Array, cell: Cell) -> Array:
    """(B, 8, 3) m: points on the six axes, flange and TCP of each pose, in base_link."""
    bodies = robot.link_poses(q)
    on_axes = [np.einsum("bij,j->bi", bodies[:, i, :3, :3], robot.point[i]) + bodies[:, i, :3, 3] for i in range(6)]
    ends = [robot.fk(q)[:, :3, 3], robot.fk(q, cell.tool.T_flange_tcp)[:, :3, 3]]
    return np.stack([*on_axes, *ends], axis=1)
