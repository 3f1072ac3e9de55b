"""Evaluate the answers of a benchmark run.

Run: ``python benchmarks/diagnosis_energy_benchmark/evaluate_answers.py out/energy [--json figures.json]``.

Names and sizes are compared by benchmarks/diagnosis_chain_benchmark/score_diagnoses.py; the rest is judged here.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1] / "diagnosis_chain_benchmark"))
import score_diagnoses
from score_diagnoses import Answer

# names that say something of the record and nothing of the robot
OF_THE_RECORD = frozenset(
    ["units", "columns", "outliers", "time_skew", "displacement_frame", "load_geometry"]
    + [f"force_sensor_{n}" for n in ("offset", "gain", "frame")]
)
TAKEN_UP = "stated nowhere"  # words for what a base takes up whole: a rotor, seals that turn over gradually
SEEN = 10.0  # noncentrality that an ordinary test sees at twice its limit


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    what: str
    hits: float
    of: int
    goal: str = ""
    ok: bool | None = None
    share: bool = True


def read(folder: Path) -> list[Answer]:
    """All cases that were run, refusals with their words."""
    out = []
    for answer in score_diagnoses.read(folder):
        report = folder / answer.truth["case"] / "run.json"
        if report.is_file():
            run = json.loads(report.read_text(encoding="utf-8"))
            answer.truth["run"] = run
            answer.problem = run["problem"] or answer.problem
            out.append(answer)
    return out


def verdict(a: Answer) -> str:
    return str((a.said or {}).get("verdict", ""))


def refused(a: Answer) -> bool:
    """Bad input, said in words: an honest answer to a broken record only."""
    return a.said is None and a.truth.get("run", {}).get("exit_code") == 2


def physics(a: Answer) -> list[dict[str, Any]]:
    """Findings that blame the robot."""
    return [f for f in a.findings if f["effect"] not in OF_THE_RECORD]


def wrong(a: Answer) -> list[dict[str, Any]]:
    return [f for f in a.findings if not score_diagnoses.right(f, a.truth["effects"])]


def due(a: Answer) -> list[dict[str, Any]]:
    """Effects that ought to be found: twice the detection limit, in a lab that could see them at all."""
    silent = not a.truth["repeats"] and verdict(a) == "insufficient"
    return [] if silent else [e for e in a.truth["effects"] if score_diagnoses.above_limit(e, a.said)]


def explained_share(a: Answer) -> float | None:
    """Share of the repeatable error on unseen readings that findings close; noise by the truth, not by the answer."""
    said, noise = a.said or {}, a.truth["oracle"]["rmse"]
    if "final" not in said or said.get("rmse_unit") != a.truth["oracle"]["unit"]:
        return None
    before, after = (float(said[k]["heldout_rmse"]) ** 2 - noise**2 for k in ("baseline", "final"))
    return 1.0 - after / before if before > 0.1 * noise**2 else None


def table(answers: list[Answer]) -> tuple[list[Row], list[tuple[Answer, str]]]:
    """Figures, and who was misled how."""
    rows: list[Row] = []
    misled: list[tuple[Answer, str]] = []

    def add(what: str, hits: int, of: int, goal: str = "", ok: Callable[[float], bool] | None = None) -> None:
        rows.append(Row(what, hits, of, goal, ok(hits / of) if ok and of else None))

    def group(*names: str) -> list[Answer]:
        return [a for a in answers if a.truth["group"] in names]

    nulls = group("null")
    alarms = [a for a in nulls if a.findings]
    misled += [(a, "nothing was concealed") for a in alarms]
    add("null: something named", len(alarms), len(nulls), "<= 1 %", lambda r: r <= 0.01)
    for channel in sorted({a.truth["channel"] for a in nulls}):
        part = [a for a in nulls if a.truth["channel"] == channel]
        add(f"  {channel}", sum(bool(a.findings) for a in part), len(part))
    restless = [a for a in nulls if verdict(a) not in ("consistent", "insufficient")]
    add("  verdict neither consistent nor insufficient", len(restless), len(nulls))
    _effects(group, add, misled)
    _large(group, add, misled)
    _masses(group, add, misled)
    _records(group("record"), add, misled)
    _verdicts(answers, add, misled)
    shares = sorted(s for a in group("single", "pair") if due(a) and (s := explained_share(a)) is not None)
    if shares:
        middle, low = shares[len(shares) // 2], shares[len(shares) // 10]
        rows.append(
            Row(
                "concealed error explained on unseen, median",
                100 * middle,
                len(shares),
                ">= 90 %",
                middle >= 0.9,
                False,
            )
        )
        rows.append(Row("  tenth of the cases below", 100 * low, len(shares), share=False))
    rows += _intervals(answers)
    return rows, misled


def _effects(group: Callable[..., list[Answer]], add: Any, misled: list[tuple[Answer, str]]) -> None:
    singles = [a for a in group("single") if due(a)]
    placed = [a for a in singles if score_diagnoses.located(a, a.truth["effects"][0])]
    add("place first named is right", len(placed), len(singles), ">= 95 %", lambda r: r >= 0.95)
    named = [(a, f) for a in group("single", "pair") for f in a.findings]
    good = sum(score_diagnoses.right(f, a.truth["effects"]) for a, f in named)
    add("precision of a named effect", good, len(named), ">= 96 %", lambda r: r >= 0.96)
    for a in group("single", "pair"):
        if bad := wrong(a):
            misled.append((a, "wrong: " + ", ".join("{} {}".format(*score_diagnoses.name_of(f)) for f in bad)))
    hits = [a for a in singles if score_diagnoses.found(a.truth["effects"][0], a.findings)]
    add("recall above twice the detection limit", len(hits), len(singles), ">= 92 %", lambda r: r >= 0.92)
    for channel in sorted({a.truth["channel"] for a in singles}):
        part = [a for a in singles if a.truth["channel"] == channel]
        add(f"  {channel}", sum(a in hits for a in part), len(part))
    quiet = [a for a in group("single") if a not in singles]
    excused = [a for a in quiet if (a.truth["effects"][0]["noncentrality"] or 0) >= SEEN]
    add("  set aside as below the stated limit", len(quiet), len(group("single")))
    add("  of these plain to a perfect test", len(excused), len(quiet))
    sets = [a for a in group("pair") if len(due(a)) == len(a.truth["effects"])]
    whole = [a for a in sets if all(score_diagnoses.found(e, a.findings) for e in a.truth["effects"])]
    add("all of two to four", len(whole), len(sets), ">= 70 %", lambda r: r >= 0.7)
    one_by_one = [(a, e) for a in group("pair") for e in due(a)]
    add("  each of two to four", sum(score_diagnoses.found(e, a.findings) for a, e in one_by_one), len(one_by_one))
    outside = group("outside")
    misnamed = [a for a in outside if wrong(a)]
    misled += [(a, "no such physics in the catalogue") for a in misnamed]
    add("outside the catalogue: misnamed", len(misnamed), len(outside), "<= 5 %", lambda r: r <= 0.05)
    add("  noticed at all", sum(verdict(a) != "consistent" for a in outside), len(outside))
    told = [a for a in outside if verdict(a) == "consistent" and TAKEN_UP in str((a.said or {}).get("sentence", ""))]
    add("  else told as refitted, stated nowhere", len(told), len(outside))
    covered = [(a, e) for a in group("single") for e in due(a) if a.findings]
    inside = sum(score_diagnoses.covered(e, a.findings) for a, e in covered)
    add("the set covers the truth", inside, len(covered), ">= 97 %", lambda r: r >= 0.97)


def _large(group: Callable[..., list[Answer]], add: Any, misled: list[tuple[Answer, str]]) -> None:
    """Effects of 60 to 250 sigmas; all are due that a perfect test sees, whatever limit is stated."""
    cases = group("large", "large_sets")
    if not cases:
        return

    def seen(a: Answer) -> list[dict[str, Any]]:
        return [e for e in a.truth["effects"] if e["noncentrality"] >= SEEN and not e["absorbed"]]

    named = [(a, f) for a in cases for f in a.findings]
    good = sum(score_diagnoses.right(f, a.truth["effects"]) for a, f in named)
    add("large: precision of a named effect", good, len(named), ">= 96 %", lambda r: r >= 0.96)
    single = [a for a in group("large") if seen(a)]
    hits = [a for a in single if score_diagnoses.found(a.truth["effects"][0], a.findings)]
    add("  recall of single effects", len(hits), len(single), ">= 92 %", lambda r: r >= 0.92)
    sets = [(a, e) for a in group("large_sets") for e in seen(a)]
    found = [score_diagnoses.found(e, a.findings) for a, e in sets]
    add("  each of two or three", sum(found), len(found))
    whole = [a for a in group("large_sets") if len(seen(a)) == len(a.truth["effects"])]
    all_found = [all(score_diagnoses.found(e, a.findings) for e in a.truth["effects"]) for a in whole]
    add("  all of two or three", sum(all_found), len(all_found), ">= 70 %", lambda r: r >= 0.7)
    for a in cases:
        if bad := wrong(a):
            misled.append((a, "wrong: " + ", ".join("{} {}".format(*score_diagnoses.name_of(f)) for f in bad)))


def _masses(group: Callable[..., list[Answer]], add: Any, misled: list[tuple[Answer, str]]) -> None:
    """Link masses 5 % off the URDF's: an ordinary deviation, which no name is right for."""
    nulls, singles = group("mass_null"), group("mass_single")
    if not nulls and not singles:
        return
    named = [a for a in nulls if a.findings]
    add("masses 5 % off: something named", len(named), len(nulls), "<= 1 %", lambda r: r <= 0.01)
    misled += [(a, "masses are 5 % off, and nothing else") for a in named]
    misled += [(a, "wrong beside masses 5 % off") for a in singles if wrong(a)]
    found = [a for a in singles if score_diagnoses.found(a.truth["effects"][0], a.findings)]
    add("  payload or gravity compensator found", len(found), len(singles))
    for level in (90, 95):
        inside, total = score_diagnoses.intervals(_only(singles, "payload"), level)
        add(f"  {level} % intervals of the payload that hold", inside, total)


def _records(records: list[Answer], add: Any, misled: list[tuple[Answer, str]]) -> None:
    kinds: dict[str, int] = dict.fromkeys(("named", "unexplained", "refused", "other", "unnoticed", "physics"), 0)
    for a in records:
        blamed = [f for f in physics(a) if not score_diagnoses.right(f, a.truth["effects"])]
        if blamed:
            kind = "physics"
            misled.append(
                (
                    a,
                    "a fault of the record called "
                    + ", ".join("{} {}".format(*score_diagnoses.name_of(f)) for f in blamed),
                )
            )
        elif any(score_diagnoses.found(e, a.findings) for e in a.truth["effects"]):
            kind = "named"
        elif refused(a):
            kind = "refused"
        elif a.findings:
            kind = "other"
        elif verdict(a) in ("unexplained", "partly_explained", "insufficient"):
            kind = "unexplained"
        else:
            kind = "unnoticed"
            misled.append((a, "a fault of the record not noticed"))
        kinds[kind] += 1
    n = len(records)
    add("record fault: named", kinds["named"], n)
    add("  refused with a message", kinds["refused"], n)
    add("  unexplained", kinds["unexplained"], n)
    add("  another fault of the record named", kinds["other"], n)
    add("  not noticed", kinds["unnoticed"], n, "0", lambda r: r == 0)
    add("  called physics", kinds["physics"], n, "0", lambda r: r == 0)


def _verdicts(answers: list[Answer], add: Any, misled: list[tuple[Answer, str]]) -> None:
    bold = [a for a in answers if verdict(a) == "explained"]
    empty = [a for a in bold if not any(score_diagnoses.right(f, a.truth["effects"]) for f in a.findings)]
    add("'explained' with nothing right in it", len(empty), len(bold), "0", lambda r: r == 0)
    known = {id(a) for a, _ in misled}
    misled += [(a, "'explained', yet nothing right is named") for a in empty if id(a) not in known]
    broken = [a for a in answers if a.said is None and not (refused(a) and a.truth["group"] == "record")]
    misled += [(a, f"no answer: {a.problem[-200:]}") for a in broken]
    add("no answer", len(broken), len(answers), "0", lambda r: r == 0)


def _intervals(answers: list[Answer]) -> list[Row]:
    """Of every effect, and all."""
    rows = []
    every: tuple[int, int] = (0, 0)
    for effect in sorted({e["effect"] for a in answers for e in a.truth["effects"]}):
        inside, total = score_diagnoses.intervals(_only(answers, effect))
        every = (every[0] + inside, every[1] + total)
        if total:
            rows.append(Row(f"  {effect}", inside, total))
    ok = 0.91 <= every[0] / every[1] <= 0.98 if every[1] else None
    narrower = score_diagnoses.intervals(answers, 90)
    share = narrower[0] / narrower[1] if narrower[1] else None
    ok90 = None if share is None else 0.86 <= share <= 0.94
    return [
        Row("95 % intervals that hold the truth", *every, "91 … 98 %", ok),
        *rows,
        Row("90 % intervals that hold the truth", *narrower, "86 … 94 %", ok90),
    ]


def _only(answers: Iterable[Answer], effect: str) -> list[Answer]:
    """The same answers, as if nothing else had been concealed."""
    out = []
    for a in answers:
        effects = [e for e in a.truth["effects"] if e["effect"] == effect]
        if effects and a.said is not None:
            out.append(replace(a, truth={**a.truth, "effects": effects}))
    return out


def text(rows: list[Row], misled: list[tuple[Answer, str]], answers: list[Answer], folder: Path) -> str:
    """The table, and each misled case with the command that shows it again."""
    out = [f"{sum(a.said is not None for a in answers)} of {len(answers)} cases answered", ""]
    for row in rows:
        value = f"{row.hits:.0f} %" if not row.share else f"{100 * row.hits / row.of:.1f} %" if row.of else "–"
        mark = {True: "ok", False: "MISSED", None: ""}[row.ok]
        out.append(f"{row.what:<48}{value:>9}{row.of:>6}  {row.goal:<10} {mark}".rstrip())
    out += ["", f"{len(misled)} misled; again: machopt diagnose {folder}/NAME/cell {folder}/NAME/recording -o out", ""]
    for a, why in misled:
        said = _said(a)
        true = "; ".join(f"{e['effect']} {e['location'][:40]}" for e in a.truth["effects"])
        out.append(f"{a.name}  {a.truth['key']}  {a.truth['robot']}: {why}")
        out.append(f"    true: {true or 'nothing'} | said: {verdict(a)}: {said or 'nothing'}")
    missed = [(a, e) for a in answers if a.truth["group"] in ("single", "pair") for e in due(a)]
    missed += [(a, e) for a in answers if a.truth["group"] in ("large", "large_sets") for e in a.truth["effects"]]
    missed = [(a, e) for a, e in missed if not score_diagnoses.found(e, a.findings)]
    out += ["", f"{len(missed)} effects missed that were due"]
    for a, e in missed:
        said = _said(a)
        loud = e["noncentrality"] or 0.0
        out.append(f"{a.name}  {a.truth['key']}: {e['effect']} {e['location']} ({loud:.0f}); said {verdict(a)}: {said}")
    return "\n".join(out)


def _said(a: Answer) -> str:
    return "; ".join(f"{f['effect']} {str(f['location'])[:40]}" for f in a.findings)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args(arguments)
    answers = read(options.folder)
    if not answers:
        print(f"{options.folder}: no case was run; start run.py first", file=sys.stderr)
        return 2
    rows, misled = table(answers)
    print(text(rows, misled, answers, options.folder))
    if options.json is not None:
        options.json.write_text(json.dumps([vars(r) for r in rows], indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
