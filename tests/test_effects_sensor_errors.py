"""Contract of every sensor error, and one added by one file and one line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from test_effects import load_test

from machopt.effects import registry
from machopt.effects.protocol import Effect, LawParameter, Quantity, RecordedLoad, RecordLaw, Shape
from machopt.measurement.diagnosis.data_types.diagnosis_problem import RecordCorrection
from machopt.measurement.diagnosis.effect_columns import sensor_errors
from machopt.measurement.diagnosis.static import load_test_channel
from machopt.numerics.array_types import Array

LAWS = [
    pytest.param(e, law, id=f"{e.name} {law.name}") for e in registry.select_record_effects() for law in e.record_laws
]


def build_recorded_load() -> RecordedLoad:
    rng = np.random.default_rng(0)
    axes, tool = (np.linalg.qr(rng.normal(size=(5, 3, 3)))[0] for _ in range(2))
    wrench, moved = rng.normal(size=(5, 6)) * 100.0, rng.normal(size=(5, 6)) * 1e-3
    return RecordedLoad(wrench, moved, axes, tool, rng.normal(size=(5, 3)))


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_law_has_one_column_per_reading_and_growing_size(effect: Effect, law: RecordLaw) -> None:
    whole = build_recorded_load()
    assert whole.position is not None
    assert len(effect.places) == 1
    for shape in (np.array(s) for s in law.grid()):
        columns = law.columns(shape, whole)
        assert columns.shape == (5, 6, len(law.coefficients))
        some = [2, 3]
        middle = whole.position.mean(axis=0)  # a frame rotates about the centre of the points
        at = np.stack([whole.position[2], 2.0 * middle - whole.position[2]])
        one = RecordedLoad(whole.wrench[some], whole.displacement[some], whole.axes[some], whole.tool[some], at)
        np.testing.assert_allclose(law.columns(shape, one)[0], columns[2], rtol=1e-14, atol=1e-15)
        values = 1e-9 * np.arange(1.0, len(law.coefficients) + 1.0)
        one_size, two = (next(iter(law.sizes(k * values, shape).values())) for k in (1.0, 2.0))
        assert two.value == pytest.approx(2.0 * one_size.value, rel=1e-7)  # a gain of the reading is 1/(1 − x) − 1
        assert one_size.unit
        assert law.equation


def test_laws_equal_simulated_sensor_errors() -> None:
    """Simulated recordings with a small sensor error: the true value is recorded plus column times coefficient, to
    first order."""
    s, size = build_recorded_load(), 1e-6
    effects = {(e.name, law.name): law for e in registry.select_record_effects() for law in e.record_laws}
    force, moment = s.wrench[:, :3], s.wrench[:, 3:]
    zero = np.zeros_like(force)
    about = s.axes[:, :, 1]
    e = s.axes[:, :, 2]
    acting = {
        ("force_sensor_offset", "zero of the force"): (1, (), np.concatenate([force - size * about, moment], axis=1)),
        ("force_sensor_gain", "gain of one axis"): (
            0,
            (2.0,),
            np.concatenate([force - size * e * np.einsum("nc,nc->n", e, force)[:, None], moment], axis=1),
        ),
        ("force_sensor_frame", "axes turned"): (
            1,
            (),
            s.wrench - size * np.concatenate([np.cross(about, force), np.cross(about, moment)], axis=1),
        ),
        ("load_geometry", "hook beside the TCP"): (
            0,
            (),
            s.wrench + np.concatenate([zero, np.cross(size * s.tool[:, :, 0], force)], axis=1),
        ),
        ("force_sensor_gain", "gain that grows with the load"): (
            0,
            (2.0, 0.0),
            np.concatenate([force - size * e * np.einsum("nc,nc->n", e, force)[:, None] ** 2, moment], axis=1),
        ),
    }
    for name, (k, shape, truth) in acting.items():
        found = s.wrench + size * effects[name].columns(np.array(shape), s)[:, :, k]
        np.testing.assert_allclose(found, truth, rtol=1e-12, err_msg=str(name))
    askew = effects["load_geometry", "pull askew"].columns(np.empty(0), s)[:, :3]
    # N²: it rotates the force and keeps its magnitude
    assert np.abs(np.einsum("nc,ncp->np", force, askew)).max() < 1e-9


@dataclass(frozen=True)
class Leaks:
    """Crosstalk of a force sensor: the vertical reading increases with the lateral force."""

    name = "crosstalk"
    equation = "f_z recorded = f_z + x |f_xy|"
    word = ""
    has_memory = False
    affected_quantity = "wrench"
    coefficients = (LawParameter(key="crosstalk", unit="1"),)
    shape: tuple[LawParameter, ...] = ()

    def columns(self, shape: Array, seen: RecordedLoad) -> Array:
        out = np.zeros((len(seen.wrench), 6, 1))
        out[:, 2, 0] = -np.linalg.norm(seen.wrench[:, :2], axis=1)
        return out

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"crosstalk": Quantity(100.0 * abs(float(values[0])), "%")}

    def grid(self) -> tuple[Shape, ...]:
        return ((),)


def test_sensor_error_is_added_by_one_file_and_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    toy = replace(registry.EFFECTS["force_sensor_gain"], name="force_sensor_crosstalk", record_laws=(Leaks(),))
    monkeypatch.setattr(registry, "EFFECTS", registry.build_registry((*registry.ALL_EFFECTS, toy)))
    r, _ = load_test()
    (h,) = (h for h in sensor_errors.build_load_test_sensor_hypotheses(r) if h.effect == toy.name)
    assert any(other.name == h.name for other in load_test_channel.build_load_test_catalogue(r, None).hypotheses)
    wrench = np.zeros_like(r.wrench)
    wrench[:, 2] = -np.linalg.norm(r.wrench[:, :2], axis=1)
    np.testing.assert_allclose(h.columns(())[:, :, 0], r.compute_displacement(wrench), rtol=1e-12, atol=1e-18)
    assert h.correction(np.array([0.02]), ()) == RecordCorrection(toy.name, "sensor:force", {"crosstalk": 2.0})


def test_wrong_tool_length_moves_load_and_target_alike() -> None:
    """Reference: the compliance of the arm at the displaced point, with the Jacobian and the force there."""
    r, _ = load_test()
    (h,) = (h for h in sensor_errors.build_load_test_sensor_hypotheses(r) if h.law == "TCP elsewhere in the tool")
    columns, step = h.columns(()), 1e-6
    for k in range(3):
        off = step * r.state.T_base_tool[:, :3, k]
        J = r.state.J.copy()
        J[:, :3] += np.cross(J[:, 3:], off[:, :, None], axis=1)
        lever = np.concatenate([J[:, :3], r.state.J[:, 3:]], axis=1)
        tau = np.einsum("nci,nc->ni", lever, r.wrench)
        there = np.einsum("nci,ni->nc", lever, tau * r.compliance)[:, : r.dimensions]
        np.testing.assert_allclose(
            (there - r.compute_displacement(r.wrench)) / step, columns[:, :, k], rtol=1e-4, atol=1e-9
        )
