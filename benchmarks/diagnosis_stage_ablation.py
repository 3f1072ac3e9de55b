"""Answers of diagnose without one stage of the model selection at a time.

    python benchmarks/diagnosis_energy_benchmark/run_energy_benchmark.py --set dev --fast --out out/energy
        writes cases and answers
    python benchmarks/diagnosis_stage_ablation.py out/energy                 # all stages
    python benchmarks/diagnosis_stage_ablation.py out/energy --only chance exchange

Each case is diagnosed again in this process, with all stages (docs/diagnosis-stages.md) and without each stage. A stage
that rejected and changed nothing in the whole run is not left out, since the answer would be the same. A search that
only later stages follow is made once for each case. The table counts wrong names, right names and verdicts that change.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import pickle
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks" / "diagnosis_chain_benchmark")]

import score_diagnoses  # noqa: E402

from machopt.measurement.diagnosis.model_selection import selection_pipeline, verdict_stages  # noqa: E402
from machopt.measurement.diagnosis.model_selection.attribution import naming_stages  # noqa: E402
from machopt.measurement.diagnosis.model_selection.evaluation import holdout_validation  # noqa: E402
from machopt.measurement.diagnosis.model_selection.search import (  # noqa: E402
    candidate_checks,
    extended_search,
    forward_selection,
    search_stages,
)
from machopt.measurement.diagnosis.model_selection.selection_stage import SelectionStage  # noqa: E402

STAGE_TABLES: tuple[tuple[str, ModuleType, str], ...] = (  # when it runs, module, name of its table
    ("search", search_stages, "SEARCH_STAGES"),
    ("search, each further effect", forward_selection, "STEP_CHECKS"),
    ("search, each candidate", candidate_checks, "CANDIDATE_CHECKS"),
    ("search, after each effect", forward_selection, "GROWTH_STAGES"),
    ("search again", extended_search, "EXTENSION_STAGES"),
    ("names", naming_stages, "NAMING_STAGES"),
    ("verdict", verdict_stages, "VERDICT_STAGES"),
)

AFTER_SEARCH = ("names", "verdict")  # stages that do not change the search
KEPT = ("few effects",)  # without it nothing is selected
FUNCTIONS = ("change", "is_passed", "find_passing", "regroup", "find_doubt")  # of the kinds of stages


@dataclass(frozen=True)
class CaseAnswer:
    """Result of one diagnosis of one case."""

    verdict: str
    right: frozenset[tuple[str, str]]  # names that are concealed
    wrong: frozenset[tuple[str, str]]  # names that are not


def list_selection_stages() -> Iterator[tuple[str, SelectionStage]]:
    """Iterate over all stages, in the order of execution, with the time when they run."""
    for when, module, name in STAGE_TABLES:
        for stage in getattr(module, name):
            yield when, stage


@contextmanager
def leave_out(name: str) -> Iterator[None]:
    """Remove a stage from its table for the duration of a block.

    Args:
        name: Name of the stage; empty: none.
    """
    kept = [(module, table, getattr(module, table)) for _, module, table in STAGE_TABLES]
    for module, table, stages in kept:
        setattr(module, table, tuple(s for s in stages if s.name != name))
    try:
        yield
    finally:
        for module, table, stages in kept:
            setattr(module, table, stages)


@contextmanager
def record_active_stages(active: set[str]) -> Iterator[None]:
    """Record the stages that reject or change something during a block.

    Args:
        active: Receives their names.
    """
    kept = [(module, table, getattr(module, table)) for _, module, table in STAGE_TABLES]
    for module, table, stages in kept:
        setattr(module, table, tuple(_record(s, active) for s in stages))
    try:
        yield
    finally:
        for module, table, stages in kept:
            setattr(module, table, stages)


def _record(stage: Any, active: set[str]) -> Any:
    """Return a stage that adds its name to a set where its result differs from what it was given."""
    name, value = next((n, getattr(stage, n)) for n in FUNCTIONS if hasattr(stage, n))

    def run(*given: Any) -> Any:
        result = value(*given)
        if _is_changed(name, given, result):
            active.add(stage.name)
        return result

    return replace(stage, **{name: run})


def _is_changed(function: str, given: tuple[Any, ...], result: Any) -> bool:
    if function == "is_passed":
        return not result
    if function == "find_passing":
        return not bool(result.all())
    if function == "find_doubt":
        return result is not None
    if function == "regroup":
        return _list_chosen(given[2]) != _list_chosen(result)
    before = given[0] if hasattr(given[0], "chosen") else given[1]
    if before is None or isinstance(before, tuple):  # a search stage, an outcome of a search
        return result is not before and (before is None or _list_chosen(before[1]) != _list_chosen(result[1]))
    return _list_chosen(before.chosen) != _list_chosen(result.chosen) or getattr(before, "base", 0) is not getattr(
        result, "base", 0
    )


def _list_chosen(chosen: Sequence[Any]) -> list[Any]:
    return [
        (c.whitened.hypothesis.name, c.whitened.hypothesis.family, c.whitened.hypothesis.law, c.scored.shape)
        for c in chosen
    ]


class SearchStore:
    """Finished searches of one case, by their input; cleared where a stage of the search is left out."""

    def __init__(self) -> None:
        self._search = selection_pipeline.search_iteratively
        self._validate = holdout_validation.search_effects
        self.found: dict[str, Any] = {}

    def __enter__(self) -> SearchStore:
        selection_pipeline.search_iteratively = self._find_state  # type: ignore[assignment]
        holdout_validation.search_effects = self._find_effects  # type: ignore[assignment]
        return self

    def __exit__(self, *_: object) -> None:
        selection_pipeline.search_iteratively = self._search
        holdout_validation.search_effects = self._validate

    def _find_state(self, problem: Any, catalogue: Any, most: int, seed: int, *rest: Any) -> Any:
        names = [h.name for h in (*catalogue.hypotheses, *catalogue.uncatalogued_hypotheses)]
        key = _hash(problem.y, problem.base, names, [u.name for u in problem.unknowns], most, seed)
        if key not in self.found:
            self.found[key] = self._search(problem, catalogue, most, seed, *rest)
        return self.found[key]

    def _find_effects(self, model: Any, laws: Any, most: int, rng: Any, variance: float) -> Any:
        key = _hash(model.y, model.X, [(t.hypothesis.name, t.shapes) for t in laws], most, rng.bit_generator.state)
        if key not in self.found:
            found = self._validate(model, laws, most, rng, variance)
            self.found[key] = (found, rng.bit_generator.state)
        found, rng.bit_generator.state = self.found[key]
        return found


def _hash(*parts: Any) -> str:
    return sha256(pickle.dumps(parts)).hexdigest()


def diagnose_case(folder: Path, case: str) -> CaseAnswer:
    """Diagnose a case of the benchmark in this process.

    Args:
        folder: Folder of the cases.
        case: Name of the case.

    Returns:
        Its verdict and names.
    """
    from machopt.cli import main as run_command

    with tempfile.TemporaryDirectory() as folder_of_answer:
        given = [str(folder / case / part) for part in ("cell", "recording")]
        out = Path(folder_of_answer) / case / "out"
        out.parent.mkdir()
        shutil.copy(folder / f"{case}.truth.json", folder_of_answer)
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            code = run_command(["diagnose", *given, "-o", str(out), "--quiet"])
        run = {"seconds": 0.0, "exit_code": code, "problem": ""}
        (out.parent / "run.json").write_text(json.dumps(run), encoding="utf-8")
        (answer,) = score_diagnoses.read(Path(folder_of_answer))
    right: set[tuple[str, str]] = set()
    wrong: set[tuple[str, str]] = set()
    for finding in answer.findings:
        is_right = score_diagnoses.right(finding, answer.truth["effects"]) or finding["effect"] == "outliers"
        (right if is_right else wrong).add(score_diagnoses.name_of(finding))
    verdict = "refused" if answer.said is None else str(answer.said["verdict"])
    return CaseAnswer(verdict, frozenset(right), frozenset(wrong))


def compare(whole: CaseAnswer, without: CaseAnswer) -> dict[str, int]:
    """Count what changes when a stage is left out."""
    return {
        "wrong names more": len(without.wrong - whole.wrong),
        "wrong names less": len(whole.wrong - without.wrong),
        "right names lost": len(whole.right - without.right),
        "right names won": len(without.right - whole.right),
        "verdicts changed": int(whole.verdict != without.verdict),
        "answers changed": int(whole != without),
    }


def _describe_case(folder: Path, case: str) -> str:
    """Return pattern and seed that run_energy_benchmark.py makes the case by."""
    truth = json.loads((folder / f"{case}.truth.json").read_text(encoding="utf-8"))
    return f"{truth['key']} --seed {truth['seed']}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print one line for each stage."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=Path, nargs="+", help="folders of cases of the energy benchmark")
    parser.add_argument("--only", nargs="*", default=[], help="stages to leave out; default: all")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    options = parser.parse_args(arguments)
    stages = [(when, s.name) for when, s in list_selection_stages() if s.name not in KEPT]
    if options.only:
        stages = [(when, name) for when, name in stages if name in options.only]
    cases = [(f, t.name.removesuffix(".truth.json")) for f in options.cases for t in sorted(f.glob("*.truth.json"))]
    sums: dict[str, dict[str, int]] = {name: {} for _, name in stages}
    for number, (folder, case) in enumerate(cases, 1):
        with SearchStore() as store:
            active: set[str] = set()
            with record_active_stages(active):
                whole = diagnose_case(folder, case)
            kept = dict(store.found)
            for when, name in stages:
                if name not in active:
                    sums[name] = {what: sums[name].get(what, 0) for what in compare(whole, whole)}
                    continue
                store.found = dict(kept) if when in AFTER_SEARCH else {}
                with leave_out(name):
                    change = compare(whole, diagnose_case(folder, case))
                for what, count in change.items():
                    sums[name][what] = sums[name].get(what, 0) + count
        print(f"{number} of {len(cases)}: {case}", file=sys.stderr, flush=True)
        if options.json is not None:
            made = [_describe_case(f, c) for f, c in cases[:number]]
            document = {"cases": number, "recordings": made, "stages": sums}
            options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    columns = list(next(iter(sums.values()))) if cases else []
    print(f"{len(cases)} cases; without the stage: " + ", ".join(columns))
    for _, name in stages:
        print(f"{name:28s} " + " ".join(f"{sums[name][c]:4d}" for c in columns))
    return 0


if __name__ == "__main__":
    sys.exit(main())
