"""Compare the answers of ``machopt diagnose`` with the truth of each case, and print one table."""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field

RECORD_NAMES = {"units", "columns", "outliers", "time_skew"}
LARGE_RATIO = 40.0  # the ratio reached that separates the two size classes
VISIBLE = 10.0  # noncentrality from which an effect counts for recall
PER_DEGREE = {"deg": 1.0, "arcmin": 60.0, "arcsec": 3600.0, "mrad": 17.4532925}


@dataclass
class CaseScore:
    """What one answer is worth."""

    key: str
    group: str
    seconds: float
    verdict: str
    named: list[tuple[str, str]]  # findings, without what is always there
    wrong: list[tuple[str, str]]
    found: list[bool]  # of each hidden effect
    countable: list[bool]  # noncentrality at least VISIBLE
    large: list[bool]
    covered: list[bool] = field(default_factory=list)  # truth in the sets of the findings
    intervals: list[bool] = field(default_factory=list)  # 90 % interval holds the true value
    fault_found: bool = False
    problem: str = ""
    truth: list[tuple[str, str]] = field(default_factory=list)


def is_accepted(name: tuple[str, str], accepted: list) -> bool:
    """Return whether a name is in a list whose places may end in ``*``."""
    return any(
        name[0] == effect and (name[1] == place or (place.endswith("*") and name[1].startswith(place[:-1])))
        for effect, place in accepted
    )


def score_case(truth: dict, answer: dict | None, seconds: float, problem: str) -> CaseScore:
    """Return the score of one case.

    Args:
        truth: content of truth.json. answer: content of diagnosis.json, or None where the command failed.
    """
    findings = answer["findings"] if answer else []
    always = truth["always_allowed"]
    named = [(f["effect"], f["location"]) for f in findings]
    counted = [n for n in named if not is_accepted(n, always)]
    right = [a for e in truth["effects"] for a in e["accepted"]] + list(truth["fault_names"])
    score = CaseScore(
        truth["case"]["key"],
        truth["case"]["group"],
        seconds,
        answer["verdict"] if answer else "failed",
        counted,
        [n for n in counted if not is_accepted(n, right)],
        [any(is_accepted(n, e["accepted"]) for n in counted) for e in truth["effects"]],
        [e["size"]["noncentrality"] >= VISIBLE for e in truth["effects"]],
        [e["size"]["ratio"] >= LARGE_RATIO for e in truth["effects"]],
        problem=problem,
        truth=[(e["effect"], e["location"]) for e in truth["effects"]],
    )
    score.fault_found = any(is_accepted(n, truth["fault_names"]) for n in named)
    sets = [tuple(o) for f in findings for o in f.get("one_of", [])] + named
    if score.group in ("single", "large") and counted:
        score.covered = [any(is_accepted(s, e["accepted"]) for s in sets) for e in truth["effects"]]
    for effect in truth["effects"]:
        score.intervals += check_intervals(effect, findings)
    return score


def check_intervals(effect: dict, findings: list[dict]) -> list[bool]:
    """Return whether the 90 % intervals hold the true values, for parameters of the same name and a known unit."""
    inside = []
    for finding in findings:
        if [finding["effect"], finding["location"]] != [effect["effect"], effect["location"]]:
            continue
        for name, (value, unit) in effect["parameters"].items():
            stated = finding.get("parameters", {}).get(name)
            if not isinstance(stated, dict) or "ci90" not in stated or isinstance(stated["value"], list):
                continue
            own = stated.get("unit", "")
            if own == unit:
                factor = 1.0
            elif own in PER_DEGREE and unit in PER_DEGREE:
                factor = PER_DEGREE[own] / PER_DEGREE[unit]
            else:
                continue
            low, high = sorted(stated["ci90"])
            inside.append(low <= value * factor <= high)
    return inside


def _state_rate(hits: list[bool]) -> str:
    return f"{sum(hits)}/{len(hits)} = {100 * sum(hits) / len(hits):.1f} %" if hits else "–"


def build_table(scores: list[CaseScore]) -> list[tuple[str, str, str]]:
    """Return rows (measure, level asked for, figure)."""
    of = {g: [s for s in scores if s.group == g] for g in ("null", "single", "large", "several", "outside", "faults")}
    alone = of["single"] + of["large"]
    physics = alone + of["several"]
    answered = [s for s in alone if s.named]
    single = [(s.found[0], s.countable[0], s.large[0]) for s in alone]
    return [
        ("null named", "≤ 1 %", _state_rate([bool(s.named) for s in of["null"]])),
        (
            "first place right (single, something named)",
            "≥ 95 %",
            _state_rate([s.named[0] not in s.wrong for s in answered]),
        ),
        ("precision of names", "≥ 96 %", _state_rate([n not in s.wrong for s in physics for n in s.named])),
        ("recall, ratio below 40", "≥ 92 %", _state_rate([f for f, c, big in single if c and not big])),
        ("recall, ratio from 40", "≥ 92 %", _state_rate([f for f, c, big in single if c and big])),
        ("all of several", "≥ 70 %", _state_rate([all(s.found) for s in of["several"] if all(s.countable)])),
        ("outside misnamed", "≤ 5 %", _state_rate([bool(s.wrong) for s in of["outside"]])),
        (
            "faults called physics",
            "0",
            _state_rate([any(n[0] not in RECORD_NAMES for n in s.named) for s in of["faults"]]),
        ),
        ("faults found", "", _state_rate([s.fault_found for s in of["faults"]])),
        ("set covers the truth (single)", "≥ 97 %", _state_rate([c for s in alone for c in s.covered])),
        ("90 % intervals hold the truth", "86–94 %", _state_rate([i for s in scores for i in s.intervals])),
        ("command failed", "0", _state_rate([bool(s.problem) for s in scores])),
        ("processor time, median", "", f"{statistics.median(s.seconds for s in scores):.1f} s" if scores else "–"),
    ]


def list_misses(scores: list[CaseScore]) -> list[str]:
    """Return one line per case with a wrong name, a missed effect or a failure."""
    lines = []
    for s in scores:
        missed = [t for t, found, c in zip(s.truth, s.found, s.countable, strict=True) if c and not found]
        physics = s.group == "faults" and any(n[0] not in RECORD_NAMES for n in s.named)
        if s.group == "outside":
            missed = []
        if not (s.wrong or missed or physics or s.problem or (s.group == "null" and s.named)):
            continue
        kind = "wrong" if s.wrong or physics else ("failed" if s.problem else "missed")
        truth = ", ".join(" ".join(t) for t in s.truth) or s.key.split("/")[2]
        answer = ", ".join(" ".join(n) for n in s.named) or "nothing"
        lines.append(f"{kind} | {s.key} | {truth} | {s.verdict}: {answer}{' | ' + s.problem if s.problem else ''}")
    return sorted(lines, reverse=True)


def build_report(scores: list[CaseScore], commit: str, command: str) -> str:
    """Return the table and the misses as Markdown."""
    counts = {g: sum(s.group == g for s in scores) for g in dict.fromkeys(s.group for s in scores)}
    lines = [
        "# Results of the bushing benchmark",
        "",
        f"Product at commit {commit}. Command: `{command}`. Cases: {', '.join(f'{g} {n}' for g, n in counts.items())}.",
        "",
        "| measure | level asked for | figure |",
        "|---|---|---|",
        *(f"| {a} | {b} | {c} |" for a, b, c in build_table(scores)),
        "",
        "## Wrong, failed and missed",
        "| kind | case | truth | answer |",
        "|---|---|---|---|",
        *(f"| {line} |" for line in list_misses(scores)),
    ]
    return "\n".join(lines) + "\n"
