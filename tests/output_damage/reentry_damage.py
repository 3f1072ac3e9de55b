"""Damages of a plan with a re-entry inside a cut."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from output_damage.damage_case import CELLS, HEADER, JOBS, Damage, Job, build_json_change, build_table_change
from output_damage.folder_damage import other_options

RADIUS, POINTS = 80.0, 25
# with these weights a re-entry reduces the cost
STIFFER = "weights={travel: 0.001, rotation: 0.003, feed: 0.05, rapid: 0.05}"


def write_ring(file: Path) -> None:
    """Write a full circle over the cylinder head that one re-entry divides."""
    angles = [2.0 * math.pi * n / (POINTS - 1) for n in range(POINTS)]
    rows = [f"{RADIUS * math.cos(a):.4f},{RADIUS * math.sin(a):.4f},-0.5,0,0,1,cut,3000" for a in angles]
    before = [f"{RADIUS},0,60,0,0,1,rapid,", f"{RADIUS},0,5,0,0,1,approach,1000"]
    after = [f"{RADIUS},0,5,0,0,1,retract,1000", f"{RADIUS},0,60,0,0,1,rapid,"]
    file.write_text("\n".join([HEADER, *before, *rows, *after]) + "\n")


def plan_ring(folder: Path) -> Job:
    """Plan the ring with one permitted re-entry; tests/test_reentry.py uses the same plan."""
    write_ring(folder / "ring.csv")
    shutil.copytree(CELLS / "kr500_milling", folder / "cell")
    posts = ("krl_pos", "rapid")
    request = OptimizeRequest(
        cell=folder / "cell",
        toolpath=folder / "ring.csv",
        out=folder / "out",
        posts=posts,
        overrides=("rotation_step_deg=15", "max_reentries=1", STIFFER),
    )
    outcome = run_optimize(request)
    assert outcome.exit_code == 0
    assert outcome.result.reentry is not None
    assert len(outcome.result.reentry[0].points) == 1
    return Job(folder / "cell", folder / "ring.csv", folder / "out", posts)


JOBS["re-entered"] = plan_ring


def _rename(word: str, by: str) -> Callable[[Job], None]:
    def change(rows: list[dict[str, str]]) -> None:
        assert any(row["move"] == word for row in rows)
        for row in rows:
            row["move"] = by if row["move"] == word else row["move"]

    return build_table_change("trajectory.csv", change)


def _leave_out_return(rows: list[dict[str, str]]) -> None:
    """Delete the approach, so that the cut continues from the retracted position."""
    link = max(n for n, row in enumerate(rows) if row["move"] == "link")
    stop = next(n for n in range(link + 1, len(rows)) if rows[n]["move"] != "approach")
    del rows[link + 1 : stop]


def _keep_posture(rows: list[dict[str, str]]) -> None:
    """Keep the joints constant from the link move to the end of the approach."""
    links = [n for n, row in enumerate(rows) if row["move"] == "link"]
    stop = next(n for n in range(links[-1] + 1, len(rows)) if rows[n]["move"] != "approach")
    left = max(n for n in range(links[0]) if rows[n]["move"] == "cut")
    joints = {name: value for name, value in rows[left].items() if name.startswith("q")}
    for row in rows[links[0] : stop]:
        row.update(joints)


def _in_entry(change: Callable[[dict[str, Any]], None]) -> Callable[[Job], None]:
    return build_json_change("result.json", lambda result: change(result["reentry"][0]))


DAMAGES = [
    Damage(f"re-entry: {name}", how_much, apply, caught_by, "re-entered")
    for name, how_much, apply, caught_by in (
        ("not permitted", "1 → 0", other_options(max_reentries=0), "re-entries"),
        ("link called rapid", "1 lift", _rename("link", "rapid"), "moves of the samples"),
        ("link called cut", "1 lift", _rename("link", "cut"), "path"),
        ("no return", "1 approach", build_table_change("trajectory.csv", _leave_out_return), "joint velocity"),
        ("posture kept", "1 lift", build_table_change("trajectory.csv", _keep_posture), "re-entries"),
        ("another point", "1 point", _in_entry(lambda e: e.update(points=[e["points"][0] + 1])), "result.json reentry"),
        (
            "no entry",
            "1 entry",
            build_json_change("result.json", lambda r: r.update(reentry=None)),
            "result.json reentry",
        ),
        (
            "a reason for all of them",
            "1 text",
            _in_entry(lambda e: e.update(reason="none pays")),
            "result.json reentry",
        ),
        ("objective", "-2 %", _in_entry(lambda e: e.update(objective=0.98 * e["objective"])), "result.json reentry"),
    )
]
