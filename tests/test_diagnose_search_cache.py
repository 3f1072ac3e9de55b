"""Search cache of load tests: the key contains every input, and the stored state is read."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import simulated_load_tests

from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.kinematics.urdf_loading import load_masses
from machopt.measurement.diagnosis.data_types.diagnosis_problem import HypothesisCatalogue
from machopt.measurement.diagnosis.effect_columns import structural_compliance
from machopt.measurement.diagnosis.model_selection import selection_pipeline, unmodelled_slip_and_external_forces
from machopt.measurement.diagnosis.model_selection.search.search_cache import SearchCache
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.static import bearing_tilt, load_test_channel
from machopt.measurement.diagnosis.static.load_test_diagnosis import LoadTestDiagnosis
from machopt.numerics.array_types import Array

TERM = StiffnessTerm("link_compliance", "link:2", {"GJ_Nm2": 4.0e6, "length_mm": 1050.0})
WRITTEN = {"progress", "searches", "predicted", "is_static", "unstated"}  # options that do not affect the search
RESULTS = {"tcp_findings"}


def build_diagnosis(**changed: Any) -> LoadTestDiagnosis:
    cell, robot, _ = simulated_load_tests.cell()
    made = simulated_load_tests.plan_load_tests(np.random.default_rng(3), poses=12)
    recording = simulated_load_tests.add_measurement_errors(made, np.random.default_rng(4), outliers=0.0)
    given: dict[str, Any] = {
        "cell": cell,
        "recording": recording,
        "robot": robot,
        "masses": load_masses(cell),
        "user_laws": [],
        "excluded": np.zeros(len(recording), bool),
        "options": selection_pipeline.DiagnosisOptions(),
        "seed": 1,
    }
    return LoadTestDiagnosis(**{**given, **changed})


def build_key(d: LoadTestDiagnosis, known: ArmStiffness | None = None, T: Array | None = None) -> Hashable:
    springs = ArmStiffness(joints=simulated_load_tests.TRUE_K) if known is None else known
    return d.build_search_key(d.cell.tool.T_flange_tcp if T is None else T, springs)


def shift(array: Array, by: float = 1e-9) -> Array:
    out = np.array(array, float)
    out.flat[-1] += by
    return out


@cache
def list_changed_inputs() -> dict[str, Callable[[LoadTestDiagnosis], Hashable]]:
    """Change each input by the smallest amount that a file can contain."""

    def changed(**what: Any) -> Callable[[LoadTestDiagnosis], Hashable]:
        return lambda d: build_key(replace(d, **what))

    def cell(**what: Any) -> Callable[[LoadTestDiagnosis], Hashable]:
        return lambda d: build_key(replace(d, cell=replace(d.cell, **what)))

    base = build_diagnosis()
    assert base.masses is not None
    assert base.cell.stiffness is not None
    limits = replace(base.cell.limits, upper=shift(base.cell.limits.upper))
    curved = replace(base.cell.stiffness, terms=(StiffnessTerm("geometric_stiffness", "arm"),))
    springs = ArmStiffness(joints=simulated_load_tests.TRUE_K)
    longer = replace(TERM, parameters={**TERM.parameters, "length_mm": 1050.0 + 1e-9})
    with_term = build_key(base, replace(springs, terms=(TERM,)))
    assert with_term != build_key(base, replace(springs, terms=(longer,)))
    rows = np.zeros(len(base.recording), bool)
    rows[3] = True
    return {
        "TCP": lambda d: build_key(d, T=shift(d.cell.tool.T_flange_tcp)),
        "springs": lambda d: build_key(d, replace(springs, joints=shift(springs.joints, 1e-3))),
        "terms": lambda _: with_term,
        "no springs": lambda d: d.build_search_key(d.cell.tool.T_flange_tcp, None),
        "robot": changed(robot=replace(base.robot, point=shift(base.robot.point))),
        "masses": changed(masses=replace(base.masses, mass=shift(base.masses.mass))),
        "no masses": changed(masses=None),
        "user_laws": changed(user_laws=[("mine.py", lambda _: [])]),
        "excluded": changed(excluded=rows),
        "options": changed(options=replace(base.options, max_effects=4)),
        "seed": changed(seed=2),
        "cell": cell(T_world_base=shift(base.cell.T_world_base)),
        "cell limits": cell(limits=limits),
        "cell K_C": cell(stiffness=curved),
    }


@pytest.mark.parametrize("name", list(list_changed_inputs()))
def test_every_input_changes_the_key(name: str) -> None:
    key = build_key(build_diagnosis())
    assert key is not None
    assert build_key(build_diagnosis()) == key  # other objects with the same content
    assert list_changed_inputs()[name](build_diagnosis()) != key


def test_every_input_field_is_covered() -> None:
    """A new field needs a changed input above, or an entry in ``WRITTEN`` or ``RESULTS``."""
    tried = set(list_changed_inputs())
    assert {f.name for f in fields(LoadTestDiagnosis)} - RESULTS - {"recording"} <= tried
    assert {f.name for f in fields(selection_pipeline.DiagnosisOptions)} == WRITTEN | {"max_effects"}


@pytest.mark.parametrize("name", [f.name for f in fields(Recording)])
def test_every_channel_and_label_of_the_recording_changes_the_key(name: str) -> None:
    d = build_diagnosis()
    old = getattr(d.recording, name)
    new: object
    if isinstance(old, np.ndarray):
        new = shift(old, 1.0)
    elif isinstance(old, StandardUncertainty):
        new = replace(old, force=7.0)
    elif isinstance(old, frozenset):
        new = old | {"session"}
    elif isinstance(old, tuple):
        new = (*old, "other")
    else:
        new = np.ones(len(d.recording)) if old is None else f"{old} other"
    assert build_key(replace(d, recording=replace(d.recording, **{name: new}))) != build_key(d)


def test_output_options_do_not_change_the_key() -> None:
    d = build_diagnosis()
    other = {"progress": print, "searches": SearchCache(), "predicted": "load tests", "is_static": True}
    options = replace(d.options, **other, unstated=frozenset({("link_compliance", "link:2")}))
    assert build_key(replace(d, options=options)) == build_key(d)


def test_input_without_content_is_never_stored() -> None:
    d = build_diagnosis()
    unknown = replace(d.recording, notes=object())
    assert build_key(replace(d, recording=unknown)) is None


@pytest.mark.slow
def test_repeated_diagnosis_reads_the_stored_search(monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[int] = []
    search = selection_pipeline.search_iteratively

    def count(*given: Any) -> SearchState:
        runs.append(1)
        return search(*given)

    def few(r: Any, curved: Array | None) -> HypothesisCatalogue:
        del curved
        laws = structural_compliance.build_structure_hypotheses(r)
        return HypothesisCatalogue(tuple(h for h in laws if h.location in ("base", "link:2")))

    monkeypatch.setattr(selection_pipeline, "search_iteratively", count)
    monkeypatch.setattr(load_test_channel, "build_load_test_catalogue", few)
    monkeypatch.setattr(bearing_tilt, "build_bearing_hypotheses", lambda _: [])
    monkeypatch.setattr(unmodelled_slip_and_external_forces, "build_interface_hypotheses", lambda _: [])
    options = selection_pipeline.DiagnosisOptions(searches=SearchCache())
    d = build_diagnosis(options=options)
    first, _ = d.run(())
    again, _ = d.run(())
    assert len(runs) == 1
    unstated = replace(options, unstated=frozenset({("link_compliance", "link:2")}))
    replace(d, options=unstated).run(())
    assert len(runs) == 1
    other, _ = replace(d, recording=replace(d.recording, displacement=2.0 * d.recording.displacement)).run(())
    assert len(runs) == 2
    assert again.heldout_after == first.heldout_after
    assert other.heldout_after != first.heldout_after
