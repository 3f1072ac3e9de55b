"""Score diagnoses of cases with hidden effects.

Run: ``python benchmarks/diagnosis_chain_benchmark/score_diagnoses.py out/chain``.

Reads OUT/<case>/out/diagnosis.json beside OUT/<case>.truth.json and prints one table and the misses.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
from unit_comparison import in_si, named_alike, same_dimension

TWICE = 10.0  # noncentrality that counts as twice a detection limit where a diagnosis states no comparable one
Named = tuple[str, str]


@dataclass
class Answer:
    """One case, its truth and what was said."""

    truth: dict[str, Any]
    said: dict[str, Any] | None
    problem: str = ""
    findings: list[dict[str, Any]] = field(default_factory=list)  # without what is always there

    @property
    def name(self) -> str:
        return str(self.truth["case"])


@dataclass
class Line:
    """One row of the table."""

    what: str
    hits: float
    of: int
    level: str
    ok: bool | None
    percent: bool = True


def read(folder: Path) -> list[Answer]:
    """All cases of a folder."""
    out = []
    for path in sorted(folder.glob("*.truth.json")):
        truth = json.loads(path.read_text(encoding="utf-8"))
        answer = folder / truth["case"] / "out" / "diagnosis.json"
        said, problem = None, ""
        if not answer.is_file():
            problem = "no diagnosis.json"
        else:
            try:
                said = json.loads(answer.read_text(encoding="utf-8"))
            except json.JSONDecodeError as error:
                problem = f"diagnosis.json is not JSON: {error}"
        one = Answer(truth, said, problem)
        one.findings = [f for f in (said or {}).get("findings", []) if not ambient(f, truth)]
        out.append(one)
    return out


def name_of(finding: dict[str, Any]) -> Named:
    return str(finding["effect"]), str(finding["location"])


def set_of(finding: dict[str, Any]) -> list[Named]:
    """Every explanation a finding leaves open."""
    return [name_of(finding), *((str(e), str(where)) for e, where in finding.get("one_of", []))]


def rows_of(location: str) -> set[int]:
    return {int(t) for t in location.removeprefix("rows:").split(",") if t.strip().isdigit()}


def same(said: Named, true: Named) -> bool:
    """Same effect and place; outliers: half of the rows said are spoilt and half of the spoilt are said."""
    if said[0] != true[0]:
        return False
    if said[0] == "outliers":
        a, b = rows_of(said[1]), rows_of(true[1])
        return bool(a) and len(a & b) >= 0.5 * len(a) and len(a & b) >= 0.5 * len(b)
    return said[1] == true[1]


def ambient(finding: dict[str, Any], truth: dict[str, Any]) -> bool:
    """What is always in such a record, and no effect of this case."""
    said = name_of(finding)
    if any(same(said, (e["effect"], e["location"])) for e in truth["effects"]):
        return False
    if said[0] == "outliers":
        rows = rows_of(said[1])
        return bool(rows) and len(rows & set(truth["outlier_rows"])) >= 0.5 * len(rows)
    return any(said == (a["effect"], a["location"]) for a in truth["ambient"])


def accepted(effect: dict[str, Any]) -> list[Named]:
    return [(str(e), str(where)) for e, where in effect["accepted"]]


def right(finding: dict[str, Any], effects: Iterable[dict[str, Any]]) -> bool:
    """The name given first is true of one of the effects."""
    return any(same(name_of(finding), a) for e in effects for a in accepted(e))


def found(effect: dict[str, Any], findings: Iterable[dict[str, Any]]) -> bool:
    """Some finding names the effect, or an explanation no such data can tell from it."""
    return any(same(name_of(f), a) for f in findings for a in accepted(effect))


def covered(effect: dict[str, Any], findings: Iterable[dict[str, Any]]) -> bool:
    """The truth itself is among the explanations left open."""
    return any(same(one, (effect["effect"], effect["location"])) for f in findings for one in set_of(f))


def above_limit(effect: dict[str, Any], said: dict[str, Any] | None) -> bool:
    """At least twice the detection limit that the diagnosis itself states, or twice an ordinary one."""
    if effect["absorbed"]:
        return False
    if effect["noncentrality"] is None:
        return True
    size = effect["size"]
    for limit in (said or {}).get("detection_limits", []):
        if (limit["effect"], limit["location"]) == (effect["effect"], effect["location"]) and limit[
            "value"
        ] is not None:
            value = same_dimension(float(limit["value"]), str(limit["unit"]), size["unit"])
            if value is not None:
                return bool(in_si(size["value"], size["unit"]) >= 2.0 * value)
    return bool(effect["noncentrality"] >= TWICE)


def located(answer: Answer, effect: dict[str, Any]) -> bool:
    """Where the diagnosis looks first is where the effect is."""
    places = [where for _, where in accepted(effect)]
    if answer.findings:
        return str(answer.findings[0]["location"]) in places or right(answer.findings[0], [effect])
    axes = (answer.said or {}).get("mismatch", [])
    return bool(axes) and str(axes[0]["axis"]) in places


def place_of(effect: dict[str, Any]) -> str:
    return f"{effect['effect']} at {effect['location'][:40]}"


def intervals(answers: Iterable[Answer], percent: int = 95) -> tuple[int, int]:
    """Intervals that hold the truth, of those that can be compared with it; of ``percent``, 90 or 95."""
    inside = total = 0
    for answer in answers:
        for effect in answer.truth["effects"]:
            for finding in answer.findings:
                if name_of(finding) != (effect["effect"], effect["location"]):
                    continue
                for name, true in effect["parameters"].items():
                    for other, said in finding.get("parameters", {}).items():
                        ends = said.get(f"ci{percent}") if isinstance(said, dict) else None
                        if ends is not None and None in ends:
                            ends = None
                        if ends is None or not named_alike(name, other):
                            continue
                        low, high = (same_dimension(float(v), str(said["unit"]), true["unit"]) for v in ends)
                        if low is None or high is None:
                            continue
                        value = in_si(true["value"], true["unit"])
                        total += 1
                        inside += min(low, high) <= value <= max(low, high) or min(low, high) <= -value <= max(
                            low, high
                        )
                        break
    return inside, total


def table(answers: list[Answer]) -> tuple[list[Line], list[str]]:
    """The figures and, one line each, every miss."""
    lines: list[Line] = []
    misses: list[str] = []
    done = [a for a in answers if a.said is not None]

    def group(*names: str) -> list[Answer]:
        return [a for a in done if a.truth["group"] in names]

    def add(what: str, hits: int, of: int, level: str, ok: Callable[[float], bool] | None) -> None:
        lines.append(Line(what, hits, of, level, ok(hits / of) if ok is not None and of else None))

    def miss(answer: Answer, words: str) -> None:
        said = "; ".join("{} {}".format(*name_of(f)) for f in answer.findings) or (answer.said or {}).get("verdict", "")
        misses.append(f"{answer.name}  {answer.truth['key']}: {words}; said {said}")

    nulls = group("null")
    alarms = [a for a in nulls if a.findings]
    for a in alarms:
        miss(a, "nothing was concealed")
    add("null: something named", len(alarms), len(nulls), "<= 1 %", lambda r: r <= 0.01)
    for ugly in (False, True):
        part = [a for a in nulls if a.truth["ugly"] == ugly]
        add(f"  {'ugly' if ugly else 'plain'}", sum(bool(a.findings) for a in part), len(part), "", None)
    restless = [a for a in nulls if (a.said or {}).get("verdict") != "consistent"]
    add("  verdict other than consistent", len(restless), len(nulls), "", None)

    # a case without an answer is a miss
    singles = [a for a in answers if a.truth["group"] in ("single", "record") and not a.truth["effects"][0]["absorbed"]]
    loud = [a for a in singles if above_limit(a.truth["effects"][0], a.said)]
    place = [a for a in loud if located(a, a.truth["effects"][0])]
    add("place first named is right", len(place), len(loud), ">= 93 %", lambda r: r >= 0.93)
    catalogue = group("single", "record", "pair", "set")
    named = [(a, f) for a in catalogue for f in a.findings]
    good = [(a, f) for a, f in named if right(f, a.truth["effects"])]
    for a, f in named:
        if not right(f, a.truth["effects"]):
            miss(a, "named wrongly: {} at {}".format(*name_of(f)))
    add("precision of a named effect", len(good), len(named), ">= 96 %", lambda r: r >= 0.96)
    hit = [a for a in loud if found(a.truth["effects"][0], a.findings)]
    for a in loud:
        if a not in hit:
            effect = a.truth["effects"][0]
            miss(a, f"missed {place_of(effect)}, noncentrality {effect['noncentrality'] or 0:.0f}")
    add("recall of single effects", len(hit), len(loud), ">= 88 %", lambda r: r >= 0.88)
    quiet = [a for a in singles if a not in loud]
    add(
        "  below twice the detection limit",
        sum(found(a.truth["effects"][0], a.findings) for a in quiet),
        len(quiet),
        "",
        None,
    )
    # a diagnosis that states high limits excuses itself: how much of that a perfect test would have seen
    excused = [a for a in quiet if (a.truth["effects"][0]["noncentrality"] or 0.0) >= TWICE]
    add("  of these plain to a perfect test", len(excused), len(quiet), "", None)
    pairs = [
        a for a in answers if a.truth["group"] == "pair" and all(above_limit(e, a.said) for e in a.truth["effects"])
    ]
    both = [a for a in pairs if all(found(e, a.findings) for e in a.truth["effects"])]
    for a in pairs:
        if a not in both:
            lost = [e["effect"] for e in a.truth["effects"] if not found(e, a.findings)]
            miss(a, f"missed {' and '.join(lost)}")
    add("both of two", len(both), len(pairs), ">= 70 %", lambda r: r >= 0.70)

    outside = group("outside")
    wrong = [a for a in outside if any(not right(f, a.truth["effects"]) for f in a.findings)]
    for a in wrong:
        miss(a, "outside the catalogue, yet named")
    add("outside the catalogue: misnamed", len(wrong), len(outside), "<= 8 %", lambda r: r <= 0.08)
    noticed = [a for a in outside if (a.said or {}).get("verdict") != "consistent"]
    add("  noticed at all", len(noticed), len(outside), "", None)

    inseparable = group("set")
    absorbed = [a for a in inseparable if all(e["absorbed"] for e in a.truth["effects"])]
    false = [a for a in absorbed if any(not right(f, a.truth["effects"]) for f in a.findings)]
    add("absorbed by the base: named wrongly", len(false), len(absorbed), "", None)
    heard = [(a, e) for a in catalogue for e in a.truth["effects"] if a.findings and above_limit(e, a.said)]
    # of a pair only what was found at all: the other half is counted above
    heard = [(a, e) for a, e in heard if len(a.truth["effects"]) == 1 or found(e, a.findings)]
    cover = [(a, e) for a, e in heard if covered(e, a.findings)]
    for a, e in heard:
        if not covered(e, a.findings):
            miss(a, f"the set leaves out {place_of(e)}")
    add("the set covers the truth", len(cover), len(heard), ">= 97 %", lambda r: r >= 0.97)

    ratios = sorted(
        float(a.said["final"]["heldout_rmse"]) / a.truth["oracle"]["rmse"]
        for a in [*hit, *both]
        if a.said is not None and a.said.get("rmse_unit") == a.truth["oracle"]["unit"] and "final" in a.said
    )
    middle = ratios[len(ratios) // 2] if ratios else float("nan")
    lines.append(
        Line(
            "held-out error over the noise, median",
            middle,
            len(ratios),
            "<= 1.05",
            middle <= 1.05 if ratios else None,
            False,
        )
    )
    inside, total = intervals(done)
    add("95 % intervals that hold the truth", inside, total, "91 … 99 %", lambda r: 0.91 <= r <= 0.99)
    add("90 % intervals that hold the truth", *intervals(done, 90), "86 … 94 %", lambda r: 0.86 <= r <= 0.94)
    for a in answers:
        if a.said is None:
            misses.append(f"{a.name}  {a.truth['key']}: {a.problem}")
    return lines, misses


def text(lines: list[Line], misses: list[str], answers: list[Answer]) -> str:
    """The table as printed."""
    done = sum(a.said is not None for a in answers)
    out = [f"{done} of {len(answers)} cases answered", "", f"{'':<44}{'':>9}{'of':>6}  level"]
    for line in lines:
        value = f"{line.hits:.3f}" if not line.percent else f"{100 * line.hits / line.of:.1f} %" if line.of else "–"
        mark = {True: "ok", False: "MISSED", None: ""}[line.ok]
        out.append(f"{line.what:<44}{value:>9}{line.of:>6}  {line.level:<10} {mark}".rstrip())
    out += ["", f"{len(misses)} misses", *misses]
    return "\n".join(out)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args(arguments)
    answers = read(options.folder)
    if not answers:
        print(f"{options.folder}: holds no *.truth.json; run generate_cases.py first", file=sys.stderr)
        return 2
    lines, misses = table(answers)
    print(text(lines, misses, answers))
    if options.json is not None:
        options.json.write_text(json.dumps([vars(line) for line in lines], indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
