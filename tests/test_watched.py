"""A number that notes what it is held against: it passes for the number, and its crossings are where answers change."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import room
import watched

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.model_selection.search import forward_selection

ASKED: list[tuple[str, float]] = [  # what is asked of t = 0.5, and the value of t at which the answer changes
    ("3.0 > t", 3.0),
    ("t <= np.float64(0.2)", 0.2),
    ("np.int64(1) > t", 1.0),
    ("1.0 < 4.0 * t", 0.25),
    ("np.float64(1.0) < np.float64(4.0) * t", 0.25),
    ("0.3 < 1.0 - t", 0.7),
    ("0.3 < 1.0 / t", 1.0 / 0.3),
    ("9.0 < (2.0 * t + 1.0) ** 2", 1.0),
    ("3.0 < np.sqrt(t)", 9.0),
    ("-0.2 > -t", 0.2),
    ("np.array([0.1, 0.3, 0.9]) > t", 0.3),
    ("np.array([3.0, 8.0]) > t * np.array([10.0, 10.0])", 0.3),
    ("4.0 < max(10.0 * t, 1.0)", 0.4),
    ("0.2 < min(t, 0.8)", 0.2),
]


@pytest.mark.parametrize("asked", [a for a, _ in ASKED])
def test_a_crossing_is_where_the_answer_changes(asked: str) -> None:
    crossing = next(at for a, at in ASKED if a == asked)
    log = {"t": watched.Seen(0.5)}
    of: dict[str, Any] = {"np": np, "max": watched._largest, "min": watched._smallest}
    said = eval(asked, of, {"t": watched._threshold(0.5, "t", log)})
    assert np.array_equal(said, eval(asked, {"np": np, "t": 0.5}))
    seen = log["t"]
    nearest = seen.below if crossing < 0.5 else seen.above
    assert nearest == pytest.approx(crossing)
    before, after = (eval(asked, {"np": np, "t": crossing * f}) for f in (0.999, 1.001))
    assert not np.array_equal(before, after)


def test_what_a_maximum_hides_leads_nowhere() -> None:
    log = {"t": watched.Seen(0.5)}
    t = watched._threshold(0.5, "t", log)
    assert not watched._largest(t, 2.0) < 1.0
    assert log["t"].asked == 0


def test_a_count_counts_on() -> None:
    t = watched._threshold(3, "t", {"t": watched.Seen(3.0)})
    assert np.round(0.12345, t) == 0.123
    assert list(range(10))[:t] == [0, 1, 2]


def test_tables_note_and_are_put_back() -> None:
    before = thresholds.DETECTION
    with watched.watching() as log:
        assert thresholds.DETECTION.gain < 31.0
        assert "max" in vars(forward_selection)
    assert thresholds.DETECTION is before
    assert "max" not in vars(forward_selection)
    assert (log["detection.gain"].above, log["detection.gain"].read) == (31.0, 1)


def test_a_threshold_set_otherwise_is_put_back() -> None:
    with watched.otherwise({"detection.gain": 7.0, "noise.least_part": 2}):
        assert (thresholds.DETECTION.gain, thresholds.NOISE.least_part) == (7.0, 2)
    assert thresholds.DETECTION.gain != 7.0


@pytest.mark.parametrize("value", [0.08, 0.7, 0.98, 1.2, 1.5, 30.0, 1e-12])
def test_a_quarter_less_and_more_stay_what_they_are(value: float) -> None:
    less, more = (room.moved(value, way, False) for way in ("less", "more"))
    assert less < value < more
    assert (more < 1.0) == (value < 1.0) or value == 0.98
    assert (less > 1.0) == (value > 1.0)


def test_the_thresholds_that_turn_an_answer_are_parted_from_those_that_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    calm: dict[str, Any] = {"verdict": "consistent", "named": []}
    wild: dict[str, Any] = {"verdict": "explained", "named": ["a"]}

    def changed(case: object, names: list[str], way: str) -> dict[str, Any]:
        return wild if "c" in names or {"e", "a"} <= set(names) else calm

    monkeypatch.setattr(room, "changed", changed)
    case: Any = None
    assert [e["names"] for e in room.turned(case, calm, list("abcdefg"), "less", [40])] == [["c"]]
    assert [e["names"] for e in room.turned(case, calm, list("abefg"), "less", [40])] == [list("abefg")]
    assert room.turned(case, calm, list("dfg"), "less", [40]) == []
