"""How much room each threshold has on concealed cases: what it was held against, and what changes when it is moved.

Every case is diagnosed once with thresholds that note what they are held against (benchmarks/watched.py), and then
again with all that it reads moved by a quarter, then with halves of them, until those are alone that change what is
said. Some load tests are identified from, too. ``benchmarks/thresholds.py --room`` is the command.
"""

from __future__ import annotations

import json
import re
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks"), str(ROOT / "benchmarks" / "concealed")]

import score  # noqa: E402  beside this file's neighbour, no package
import watched  # noqa: E402

QUARTER = 1.25  # a threshold is moved by so much
MOST_RUNS = 24  # diagnoses of a case, either way
NOT_PARTED = "not parted: too many diagnoses"
LONGEST = 4.0  # s of the processor that one may take: cases that take longer are not varied


@dataclass(frozen=True)
class Case:
    """A case that lies in a folder of benchmarks/concealed/run.py or benchmarks/stranger/run.py, and a command."""

    folder: Path
    truth: dict[str, Any]
    command: str  # diagnose or identify

    @property
    def name(self) -> str:
        return f"{self.command} {self.folder.name}/{self.truth['case']}"

    @property
    def at(self) -> Path:
        return self.folder / str(self.truth["case"])


def cases(folders: list[Path]) -> list[Case]:
    """All that lie in the folders, shuffled so that any first part of them is an even one."""
    found = []
    for folder in folders:
        for path in sorted(folder.glob("*.truth.json")):
            truth = json.loads(path.read_text(encoding="utf-8"))
            third = zlib.crc32(truth["case"].encode()) % 3 == 0  # identification takes longer and asks for less
            load_test = third and load_kind(folder / truth["case"]) == "deflection"
            found += [Case(folder, truth, command) for command in ("diagnose", "identify")[: 1 + load_test]]
    return [found[k] for k in np.random.default_rng(0).permutation(len(found))]


def load_kind(case: Path) -> str:
    """The kind that a recording states."""
    return str(YAML(typ="safe").load(case / "recording" / "recording.yaml").get("kind", ""))


def answer(case: Case) -> dict[str, Any]:
    """What is said of a case, and what is right of it; a refusal is right where the record is broken."""
    from machopt.errors import MachoptError

    try:
        return _diagnosed(case) if case.command == "diagnose" else _identified(case)
    except MachoptError as error:
        broken = case.truth["group"] == "record"
        said = {"verdict": "refused", "named": [], "wrong": int(not broken), "right": int(broken)}
        return said | {"why": str(error)[:200]}


def _identified(case: Case) -> dict[str, Any]:
    """Which joints are identified, and the warnings without their numbers."""
    from machopt.commands.identify.computation import compute_identification
    from machopt.measurement.identification.request import IdentifyRequest

    request = IdentifyRequest(cell=case.at / "cell", recordings=(case.at / "recording",), out=case.at, studies=False)
    found = compute_identification(request, lambda _: None).identification
    joints = [f"joint {j.joint}" for j in found.joints if j.identified]
    words = [re.sub(r"[\d.]+", "#", w)[:30] for w in found.warnings]
    return {"verdict": "identified", "named": sorted([*joints, *words]), "wrong": 0, "right": 0}


def _diagnosed(case: Case) -> dict[str, Any]:
    from machopt.commands.diagnose.run import compute_diagnosis
    from machopt.measurement.diagnosis.request import DiagnoseRequest

    request = DiagnoseRequest(cell=case.at / "cell", recordings=(case.at / "recording",), out=case.at / "out")
    said = json.loads(compute_diagnosis(request, (), lambda _: None).result.model_dump_json())
    findings = [f for f in said["findings"] if not score.ambient(f, case.truth)]
    right = [score.right(f, case.truth["effects"]) for f in findings]
    return {
        "verdict": said["verdict"],
        "named": sorted(" ".join(score.name_of(f)) for f in said["findings"]),
        "wrong": len(right) - sum(right),
        "right": sum(score.found(e, findings) for e in case.truth["effects"]),
    }


def watch(case: Case) -> dict[str, Any]:
    """One line of the log: the answer to a case, and what each threshold was held against in it."""
    start = process_time()
    with watched.watching() as log:
        said = answer(case)
    seen = {
        name: {"n": s.asked, "below": s.below, "above": s.above, "lower": s.lower, "higher": s.higher, "read": s.read}
        | {"where": sorted(s.where)}
        for name, s in log.items()
        if s.read
    }
    truth = {k: case.truth.get(k) for k in ("group", "key", "channel", "kind")}
    return {"case": case.name, **truth, "said": said, "seen": seen, "seconds": round(process_time() - start, 2)}


def run(out: Path, folders: list[Path], seconds: float) -> None:
    """Appends to ``out`` the lines of cases that it lacks, for so many seconds of the processor."""
    out.parent.mkdir(parents=True, exist_ok=True)
    done = {line["case"] for line in lines(out)}
    start = process_time()
    with out.open("a", encoding="utf-8") as file:
        for case in cases(folders):
            if case.name not in done and process_time() - start < seconds:
                file.write(json.dumps(watch(case)) + "\n")
                file.flush()


def lines(out: Path) -> Iterator[dict[str, Any]]:
    if out.is_file():
        yield from map(json.loads, out.read_text(encoding="utf-8").splitlines())


def moved(value: float, way: str, whole: bool) -> float:
    """A threshold moved by a quarter: of itself, or of what parts a share or a factor near one from one."""
    factor = QUARTER if way == "more" else 1.0 / QUARTER
    if whole:
        step = max(1, round(abs(value) * (QUARTER - 1.0)))
        return max(1, int(value) + (step if way == "more" else -step))
    if 0.5 < value < 1.0:
        return 1.0 - (1.0 - value) / factor
    return 1.0 + (value - 1.0) * factor if 1.0 < value < 2.0 else value * factor


def turned(case: Case, said: dict[str, Any], names: list[str], way: str, budget: list[int]) -> list[dict[str, Any]]:
    """Which of the thresholds, moved by a quarter, change what is said of a case: halves of those that do together.

    Thresholds that change it only together are one entry. ``budget`` counts down the diagnoses that may still be made.
    """
    if not names:
        return []
    if budget[0] <= 0:
        return [{"names": names, "why": NOT_PARTED}]
    budget[0] -= 1
    now = changed(case, names, way)
    if same(now, said):
        return []
    if len(names) == 1:
        return [{"names": names, "said": now}]
    middle = len(names) // 2
    parts = [entry for half in (names[:middle], names[middle:]) for entry in turned(case, said, half, way, budget)]
    return parts or [{"names": names, "said": now, "why": "only together"}]


def changed(case: Case, names: list[str], way: str) -> dict[str, Any]:
    """What is said of a case with some thresholds moved by a quarter."""
    values = {t.key: t for t in every()}
    with watched.otherwise({n: moved(values[n].value, way, isinstance(values[n].value, int)) for n in names}):
        return answer(case)


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return _told(one) == _told(other)


def _told(said: dict[str, Any]) -> tuple[str, list[str]]:
    """Verdict and names; which rows are outliers is no other answer."""
    return said["verdict"], sorted({n.split(" rows:")[0] for n in said["named"]})


def every() -> list[Any]:
    from machopt.measurement.diagnosis import thresholds

    return list(thresholds.list_thresholds())


def vary(out: Path, log: Path, folders: list[Path], seconds: float) -> None:
    """Appends to ``out``, case by case and either way, which thresholds change its answer when moved by a quarter."""
    known = {line["case"]: line for line in lines(log)}
    done = {line["case"] for line in lines(out)}
    start = process_time()
    with out.open("a", encoding="utf-8") as file:
        for case in cases(folders):
            line = known.get(case.name)
            if line is None or case.name in done or line["seconds"] > LONGEST or process_time() - start > seconds:
                continue
            of = {t.key: t.value for t in every()}
            names = [str(n) for n in np.random.default_rng(len(done)).permutation(sorted(line["seen"]))]
            begun = process_time()
            ways = {w: turned(case, line["said"], names, w, [MOST_RUNS]) for w in ("less", "more")}
            done.add(case.name)
            took = round(process_time() - begun, 1)
            told = {
                "case": case.name,
                "group": line["group"],
                "said": line["said"],
                "values": {n: of[n] for n in names},
            }
            file.write(json.dumps(told | ways | {"seconds": took}) + "\n")
            file.flush()


def table(log: Path, varied: Path, kept: dict[str, Any]) -> dict[str, list[Any]]:
    """The rows of rooms.json, in the order of ``ThresholdSensitivity``; ``kept`` are tests by threshold."""
    logged, again = list(lines(log)), list(lines(varied))
    return {t.key: [*_row(t, logged, again), sorted(kept.get(t.key, []))] for t in every()}


def _row(t: Any, logged: list[dict[str, Any]], again: list[dict[str, Any]]) -> list[Any]:
    seen = [line["seen"][t.key] for line in logged if t.key in line["seen"]]
    below, above = _free(t, seen)
    tried = [line for line in again if line["values"].get(t.key) == t.value and _parted(line, t.key)]
    ways = [[_judged(line, t.key, way) for line in tried] for way in ("less", "more")]
    counts = [[w.count(kind) for kind in ("better", "worse", "otherwise")] for w in ways]
    held = [sum(s["n"] for s in seen), _rounded(below), _rounded(above)]
    return [t.value, len(seen), *held, len(tried), *counts]


def _free(t: Any, seen: list[dict[str, Any]]) -> tuple[float, float]:
    """Between which values of a threshold no answer to it changes in any case.

    Raises:
        ValueError: it was changed beyond what a case was asked about: what is nearest to it now is not known.
    """
    lost = [s for s in seen if s["n"] > 2 and not s["below"] <= t.value <= s["above"]]
    if lost:
        raise ValueError(f"{t.key} was set otherwise since: run the cases again")
    near = np.array([x for s in seen for x in (s["below"], s["above"])])
    return near.max(initial=-np.inf, where=near <= t.value), near.min(initial=np.inf, where=near > t.value)


def _rounded(value: float) -> float | None:
    return float(f"{value:.6g}") if np.isfinite(value) else None


def _parted(line: dict[str, Any], key: str) -> bool:
    """Whether it is known of each way what this threshold alone does."""
    return not any(key in e["names"] and e.get("why") == NOT_PARTED for way in ("less", "more") for e in line[way])


def _judged(line: dict[str, Any], key: str, way: str) -> str:
    """How the answer to a case changes with a threshold moved one way: empty where it does not, or not by it alone."""
    said = next((e["said"] for e in line[way] if e["names"] == [key]), None)
    if said is None:
        return ""
    right, wrong = (said[k] - line["said"][k] for k in ("right", "wrong"))
    if right == wrong == 0:
        return "otherwise"
    return "better" if right >= 0 >= wrong else "worse" if right <= 0 <= wrong else "otherwise"


def together(varied: Path) -> list[int]:
    """Cases answered again with all thresholds moved at once, and how many answers that changed either way."""
    again = list(lines(varied))
    return [len(again), *(sum(bool(line[way]) for line in again) for way in ("less", "more"))]


def write(path: Path, rows: dict[str, list[Any]], at_once: list[int], sets: list[str], date: str) -> None:
    """rooms.json, a line a threshold."""
    body = ",\n".join(f"    {json.dumps(key)}: {json.dumps(row)}" for key, row in rows.items())
    head = {"script": "benchmarks/thresholds.py --room", "date": date, "sets": sets, "together": at_once}
    text = "".join(f"  {json.dumps(k)}: {json.dumps(v)},\n" for k, v in head.items())
    path.write_text("{\n" + text + '  "rooms": {\n' + body + "\n  }\n}\n", encoding="utf-8")
