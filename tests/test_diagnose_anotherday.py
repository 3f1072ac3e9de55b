"""What one session shows and another contradicts is no physics of the robot, nor of an instrument that both used."""

from __future__ import annotations

import numpy as np
import pytest
from test_diagnose_drift import problem, timed

from machopt.diagnose import at_sensor, engine
from machopt.diagnose.problem import Catalogue


@pytest.mark.parametrize("days", [(0, 1), (1,)])
def test_a_law_is_named_where_every_session_shows_it(days: tuple[int, ...]) -> None:
    r, _, _ = timed()
    laws = tuple(h for h in at_sensor.hypotheses(r) if h.effect in ("force_sensor_frame", "force_sensor_offset"))
    turned = next(h for h in laws if h.effect == "force_sensor_frame")
    moved = turned.columns(turned.shapes[0]) @ np.full(3, 0.01)
    moved[~np.isin(r.session, days)] = 0.0
    found = engine.diagnose(problem(r, moved), Catalogue(laws), engine.Options(), np.random.default_rng(0))
    contradicted = [n for n in found.notes if "sessions differ" in n]
    if len(days) > 1:
        assert [f.effect for f in found.findings] == ["force_sensor_frame"]
        assert not contradicted
    else:
        assert not found.findings
        assert found.verdict == "unexplained"
        assert len(contradicted) == 1
