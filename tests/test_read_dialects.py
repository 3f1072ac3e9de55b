"""A known path, written in each dialect, is read back as that path."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dialect_writers import DIALECTS, PLANES, Array, Dialect, Leg
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from property_example_count import NIGHTLY, scale_example_count

from machopt.toolpath.toolpath_reader import read_toolpath

NEAR = 2e-6  # mm: numbers are written to 1e-10 units, those of robots in metres to 1e-13; the rest is double precision
SAGITTA = 0.0101  # mm: the sagitta of the chords is at most 0.01 mm
COORDINATE = st.integers(-200_000, 200_000).map(lambda v: v / 1000.0)  # mm


def legs(dialect: Dialect) -> st.SearchStrategy[list[Leg]]:
    """Return paths that the dialect can express."""
    return st.lists(_move(dialect), min_size=1, max_size=8).map(_join_moves)


def _move(d: Dialect) -> st.SearchStrategy[tuple[Any, ...]]:
    point = st.tuples(COORDINATE, COORDINATE, COORDINATE)
    feed = st.integers(10, 9000).map(float)
    kinds: list[st.SearchStrategy[tuple[Any, ...]]] = [
        st.tuples(st.just("rapid"), point),
        st.tuples(st.just("cut"), point, feed, st.integers(1, 7)),
    ]
    if d.arcs:
        part = st.integers(6, 354) | (st.just(360) if d.full else st.just(90))
        sweep = st.tuples(part, st.integers(0, d.turns), st.booleans())
        spoke = st.tuples(st.integers(500, 80_000), st.floats(0.0, 6.28))
        rise = (COORDINATE.map(lambda v: v / 10.0) | st.just(0.0)) if d.helices else st.just(0.0)
        kinds.append(st.tuples(st.just("arc"), st.sampled_from(d.planes), sweep, spoke, rise, feed))
    return st.one_of(kinds)


def _join_moves(moves: list[tuple[Any, ...]]) -> list[Leg]:
    """Return consecutive moves: the first is rapid, the last is a cut."""
    at = np.array([1.5, -2.25, 50.0])
    out = [Leg(np.zeros(3), at, float("nan"))]
    for m in [*moves, ("cut", (3.0, 4.0, -5.5), 600.0, 7)]:
        if m[0] == "arc":
            _, plane, (part, turns, left), (radius, phase), rise, feed = m
            i, j, k = PLANES[plane]
            centre = at.copy()
            centre[i] -= radius / 1e3 * np.cos(phase)
            centre[j] -= radius / 1e3 * np.sin(phase)
            centre = np.round(centre, 9)
            sweep = (part + 360.0 * turns) * (1 if left else -1)
            end = at.copy()
            end[k] += rise
            leg = Leg(at, end, feed, (plane, centre, sweep))
            end = at.copy() if leg.full else leg.points(np.array([1.0]))[0]
            end[k] = at[k] + rise
            leg = Leg(at, np.round(end, 9), feed, leg.arc)
        else:
            end = np.array(m[1], dtype=float)
            if m[0] == "cut":
                end = np.where([int(m[3]) & 1, int(m[3]) & 2, int(m[3]) & 4], end, at)
            if (end == at).all():
                end = at + np.array([0.0, 0.0, 1.0])
            leg = Leg(at, end, float(m[2]) if m[0] == "cut" else float("nan"))
        out.append(leg)
        at = leg.end
    return out


@pytest.mark.parametrize("name", DIALECTS)
@settings(
    max_examples=scale_example_count(25),
    deadline=None,
    derandomize=not NIGHTLY,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data(), seed=st.integers(0, 2**20))
def test_path_is_read_back(tmp_path: Path, name: str, data: st.DataObject, seed: int) -> None:
    dialect = DIALECTS[name]
    path = data.draw(legs(dialect))
    rng = random.Random(seed)
    text = dialect.write(path, rng)
    file = tmp_path / f"a{dialect.suffix}"
    file.write_bytes((rng.choice(["\n", "\r\n"]).join(text.lines) + rng.choice(["", "\n"])).encode())
    t = read_toolpath(file)
    place = t.position * 1e3
    last = -1
    for n, leg in enumerate(path):
        lines = [line for line, k in text.leg_of_line.items() if k == n]
        rows = np.flatnonzero(np.isin(t.line, lines))
        assert len(rows), (n, text.lines)
        assert rows[0] == last + 1, "points out of order, or one too many"
        last = rows[-1]
        assert np.abs(place[last] - leg.end).max() < NEAR, (n, place[last], leg.end, text.lines)
        assert (np.isnan(t.feed[rows]) == leg.rapid).all(), (n, text.lines)
        if not leg.rapid:
            assert np.allclose(t.feed[rows] * 60e3, leg.feed, rtol=1e-8), (n, text.lines)
        if leg.arc is not None:
            _on_the_arc(place[rows], leg, text.lines)
        else:
            assert len(rows) == 1, (n, text.lines)
    assert last == len(t) - 1
    assert np.allclose(t.axis, [0.0, 0.0, 1.0], atol=1e-12)


def _on_the_arc(points: Array, leg: Leg, lines: list[str]) -> None:
    """Check that the chord ends are in order along the curve and close enough together."""
    assert leg.arc is not None
    every = np.vstack([leg.start, points])
    count = len(points)
    wanted = leg.points(np.arange(1, count + 1) / count)
    assert np.abs(points - wanted).max() < 1e-5, (np.abs(points - wanted).max(), lines)  # uniform steps
    middles = leg.points((np.arange(count) + 0.5) / count)
    chords = (every[1:] + every[:-1]) / 2
    assert np.linalg.norm(middles - chords, axis=1).max() < SAGITTA, lines
