"""What no effect of the catalogue is keeps others from its place, is said with it, and is never named."""

from __future__ import annotations

import numpy as np
import pytest
from test_diagnose_drift import timed
from test_effects import posed

from machopt.diagnose.laws import at_sensor
from machopt.diagnose.nouns.problem import Catalogue
from machopt.diagnose.nouns.readings import Readings
from machopt.diagnose.search import engine, unnamed


def catalogue(r: Readings) -> Catalogue:
    return Catalogue((*at_sensor.hypotheses(r), *unnamed.hypotheses(r)))


@pytest.mark.parametrize("law", [unnamed.SLIPS, unnamed.JUMPS])
def test_what_has_no_name_is_said_with_its_place_and_not_named(law: str) -> None:
    r, _, _ = timed()
    true = next(h for h in unnamed.hypotheses(r) if h.law == law)
    size = np.eye(9)[2] if law == unnamed.JUMPS else np.ones(1)
    moved = true.columns((0.6,)) @ (8e-5 * size)
    found = engine.diagnose(posed(r, moved), catalogue(r), engine.Options(), np.random.default_rng(0))
    assert not found.findings
    assert found.verdict == "unexplained"
    assert [n for n in found.notes if f"something at {true.location}" in n]
    assert next(s.axis for s in found.mismatch if s.kind == "machine") == true.location
    assert not {x.effect for x in found.limits} & {true.effect}


def test_a_law_of_the_catalogue_is_named_beside_it() -> None:
    r, _, _ = timed()
    turned = next(h for h in at_sensor.hypotheses(r) if h.effect == "force_sensor_offset")
    slips = next(h for h in unnamed.hypotheses(r) if h.law == unnamed.SLIPS)
    moved = turned.columns(turned.shapes[0]) @ np.full(3, 60.0) + slips.columns((0.6,)) @ np.full(1, 8e-5)
    found = engine.diagnose(posed(r, moved), catalogue(r), engine.Options(), np.random.default_rng(0))
    assert [f.effect for f in found.findings] == ["force_sensor_offset"]
    assert found.verdict == "partly_explained"


def test_a_slip_begins_beyond_its_load_and_stays_for_the_cycle() -> None:
    along = np.array([[1.0, 0, 0]] * 4 + [[0, 1.0, 0]] * 3)
    share = np.array([0.3, 0.8, 1.0, 0.2, 0.3, 0.5, 0.2])
    slipped = unnamed._slipped(along, share, np.array([0, 0, 0, 0, 1, 1, 1]), 0.6)
    np.testing.assert_array_equal(slipped, [[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0], *np.zeros((3, 3))])


def test_friction_of_a_jack_holds_back_until_the_load_falls() -> None:
    share, cycle = np.array([0.5, 1.0, 0.5, 1.0, 0.4]), np.array([0, 0, 0, 1, 1])
    np.testing.assert_array_equal(unnamed._risen(share, cycle), [-1, -1, 1, -1, 1])
