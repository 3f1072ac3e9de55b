"""``machopt identify``: from a cell and load tests to a stiffness file with its uncertainty, and a page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

import machopt
from machopt.domain.cell import Cell
from machopt.domain.recording import Recording
from machopt.domain.results.identification import IdentificationResult
from machopt.domain.stiffness import Term
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.readings import write_readings_csv
from machopt.formats.recording import load_recording, load_recordings
from machopt.formats.stiffness import write_stiffness
from machopt.formats.yamlstrict import parse_yaml
from machopt.identify.check import CODES
from machopt.identify.experiment import experiment
from machopt.identify.options import IdentifyOptions
from machopt.identify.pipeline import identify
from machopt.identify.result import Identification
from machopt.identify.uncertainty import uncertainty
from machopt.identify.units import same_factor
from machopt.model.linkage import refuse_linked
from machopt.model.robot import load_masses, load_robot
from machopt.model.terms import compile_terms
from machopt.output import output_folder, write_result
from machopt.report.identification_page import write_identification
from machopt.services.identify_page import page_of
from machopt.services.inputs import input_hashes, recording_inputs, single
from machopt.services.manifest import write_command_manifest

CI90 = 0.9


@dataclass(frozen=True)
class Request:
    """One run; lengths in mm, as typed."""

    cell: Path
    recordings: tuple[Path, ...]
    out: Path
    model: str = "auto"
    terms: tuple[str, ...] = ()  # EFFECT@LOCATION, or EFFECT@LOCATION{key: value, …}
    geometric: bool = False
    plain: bool = False  # dumas2011 eq. 26: no weights, no bounds, outliers kept
    robust: bool = True
    grid_cell_mm: float = 300.0
    grid_origin_mm: tuple[float, ...] | None = None
    grid_shape: tuple[int, ...] | None = None
    level_percent: float = 90.0
    studies: bool = True
    accept: tuple[str, ...] = ()
    seed: int = 0
    allow_external: bool = False
    effects: tuple[Path, ...] = ()  # Python files with effects of the user's own, which --fit may name


@dataclass(frozen=True)
class Outcome:
    """What came out."""

    identification: Identification
    result: IdentificationResult
    report: Path


def run_identify(request: Request, progress: Callable[[str], None] = lambda _: None) -> Outcome:
    """Identify the stiffness of a cell's robot from one or several recordings.

    Raises:
        InputError: bad cell, recording, options or output folder; a record that cannot be right.
    """
    with in_use(with_effects(request.effects)):
        return _identify(request, progress)


def _identify(request: Request, progress: Callable[[str], None]) -> Outcome:
    options = _options(request)
    progress("reading cell and recording")
    cell = load_cell(request.cell, allow_external=request.allow_external)
    recording = _recording(request.recordings)
    refuse_linked(cell, "identify")
    robot = load_robot(cell)
    tests = experiment(recording, robot, cell.tool.T_flange_tcp)
    for text, term in zip(request.terms, options.terms, strict=True):
        try:
            compile_terms((term,), robot, cell.tool.T_flange_tcp)
        except InputError as problem:
            raise InputError(problem.reason, where=f"--fit {text}") from None
    masses = load_masses(cell) if options.geometric else None
    with output_folder(request.out) as folder:
        progress("identifying")
        found = identify(
            tests, robot, cell.tool.T_flange_tcp, cell.stiffness, options, np.random.default_rng(options.seed), masses
        )
        progress("writing stiffness and tables")
        result = result_of(request, cell, recording, found)
        write_stiffness(folder / "stiffness.yaml", found.stiffness)
        t = found.table
        write_readings_csv(
            folder / "readings.csv",
            pose=tests.pose,
            cycle=recording.cycle,
            session=tests.session,
            line=tests.line,
            wrench=tests.wrench,
            measured=t.measured,
            predicted=t.predicted,
            heldout=t.measured - t.heldout,
            uncertainty=t.uncertainty,
            weight=t.weight,
            leverage=found.influence.leverage,
        )
        progress("report")
        write_identification(folder / "report.html", page_of(cell, recording, tests, found, _facts(result)))
        write_result(folder / "identification.json", result)
        read = (*recording_inputs(request.recordings), *(single(f, "effects") for f in request.effects))
        write_command_manifest(folder, "identify", request, cell, verdict="identified", inputs=read)
    return Outcome(found, result, request.out / "report.html")


def _recording(paths: tuple[Path, ...]) -> Recording:
    return load_recording(paths[0]) if len(paths) == 1 else load_recordings(paths)


def _options(request: Request) -> IdentifyOptions:
    if request.model not in ("auto", "constant", "grid"):
        raise InputError(f"found {request.model!r}; valid: auto, constant, grid", where="--model")
    if not (isfinite(request.grid_cell_mm) and request.grid_cell_mm > 0):
        raise InputError(f"found {request.grid_cell_mm:g}; more than zero would work", where="--grid-cell-mm")
    for name, value in (("--grid-origin-mm", request.grid_origin_mm), ("--grid-shape", request.grid_shape)):
        if value is not None and len(value) != 3:
            raise InputError(f"found {len(value)} numbers; expected three, x,y,z", where=name)
    if request.grid_shape is not None and min(request.grid_shape) < 1:
        raise InputError(f"found {min(request.grid_shape)}; at least one cell along each axis", where="--grid-shape")
    if not 50.0 <= request.level_percent < 100.0:
        raise InputError(f"found {request.level_percent:g}; 50 to below 100 would work", where="--level")
    if request.plain and request.model == "grid":
        raise InputError(
            "the plain least squares of dumas2011 has no grid; --model constant would work", where="--plain"
        )
    for code in request.accept:
        if code not in CODES:
            raise InputError(f"found {code!r}; valid: {', '.join(CODES)}", where="--accept")
    origin, shape = request.grid_origin_mm, request.grid_shape
    return IdentifyOptions(
        model="constant" if request.plain else request.model,  # type: ignore[arg-type]
        terms=tuple(term_from_text(t) for t in request.terms),
        geometric=request.geometric,
        load_effect=not request.plain,
        weighted=not request.plain,
        robust=request.robust and not request.plain,
        bounded=not request.plain,
        grid_cell=request.grid_cell_mm / 1e3,
        grid_origin=None if origin is None else (origin[0] / 1e3, origin[1] / 1e3, origin[2] / 1e3),
        grid_shape=None if shape is None else (shape[0], shape[1], shape[2]),
        level=request.level_percent / 100.0,
        studies=request.studies,
        accept=frozenset(request.accept),
        seed=request.seed,
    )


def term_from_text(text: str) -> Term:
    """``link_compliance@link:4`` or ``tool_compliance@tool{length_mm: 400}`` as a term to be fitted.

    Raises:
        InputError: not of that form.
    """
    head, brace, rest = text.partition("{")
    effect, at, location = head.strip().partition("@")
    if not at or not effect or not location:
        raise InputError(f"found {text!r}; EFFECT@LOCATION, e.g. link_compliance@link:4, would work", where="--fit")
    parameters: object = {}
    if brace:
        parameters = parse_yaml("{" + rest, "--fit").value
        if not isinstance(parameters, Mapping):
            raise InputError(f"found {text!r}; {{key: value, …}} would work after the location", where="--fit")
    return Term(effect, location, dict(parameters))  # type: ignore[call-overload]


def result_of(request: Request, cell: Cell, recording: Recording, found: Identification) -> IdentificationResult:
    """``identification.json``."""
    errors, unseen = found.errors, found.heldout
    joints90, terms90 = _ninety(found)
    out: dict[str, Any] = {
        "machopt_identification": 1,
        "version": machopt.__version__,
        "cell": cell.name,
        "recording": recording.source,
        "model": found.model,
        "readings": found.readings,
        "poses": found.poses,
        "joints": [
            {
                "joint": j.joint,
                "k_Nm_per_rad": j.k,
                "ci90": [low, _finite(high)],
                "identified": j.identified,
                "reason": j.reason,
                "largest_torque_Nm": j.torque,
                "compliance_sigma_rad_per_Nm": _finite(j.sigma),
                "interval": [j.interval[0], _finite(j.interval[1])],
            }
            for j, (low, high) in zip(found.joints, joints90, strict=True)
        ],
        "terms": [
            {
                "effect": t.effect,
                "location": t.location,
                "coefficient": t.name,
                "unit": t.unit,
                "value": t.value,
                "ci90": [_finite(v) for v in ci90],
                "identified": t.identified,
                "reason": t.reason,
                "interval": [_finite(v) for v in t.interval],
            }
            for t, ci90 in zip(found.terms, terms90, strict=True)
        ],
        "known_combinations": list(found.combinations),
        "rmse_mm": 1e3 * errors.rmse,
        "heldout_rmse_mm": None if unseen is None else 1e3 * unseen.rmse,
        "rmse_mrad": _finite(1e3 * errors.rotation),
        "heldout_rmse_mrad": None if unseen is None else _finite(1e3 * unseen.rotation),
        "explained_share": errors.explained,
        "heldout_explained_share": None if unseen is None else unseen.explained,
        "condition_number": found.condition_number,
        "condition_number_dumas2011": found.condition_plain,
        "interval_level": request.level_percent / 100.0,
        "outliers": [
            {
                "reading": o.reading + 1,
                "place": o.place,
                "component": ("dx", "dy", "dz", "rx", "ry", "rz")[o.axis],
                "residual": 1e3 * o.residual,
                "unit": "mm" if o.axis < 3 else "mrad",
                "sigmas": o.sigmas,
            }
            for o in found.outliers
        ],
        "noise_mm": _scatter(found),
        "findings": [
            {"code": f.code, "severity": f.severity, "message": f.message, "rows": [r + 1 for r in f.rows]}
            for f in found.findings
        ],
        "warnings": [*cell.warnings, *recording.warnings, *found.warnings, *_alike(found, cell)],
        "notes": [*found.notes, *([found.why_model] if found.why_model else [])],
        "options": {
            "model": request.model,
            "fit": list(request.terms),
            "geometric": request.geometric,
            "plain": request.plain,
            "robust": request.robust,
            "grid_cell_mm": request.grid_cell_mm,
            "seed": request.seed,
        },
        "inputs": input_hashes(cell, request.recordings),
    }
    if found.grid is not None:
        g = found.grid
        grid, constant = g.heldout.rmse
        out["grid"] = {
            "cell_mm": 1e3 * g.grid.cell,
            "origin_mm": (1e3 * g.grid.origin).tolist(),
            "shape": list(g.grid.shape),
            "heldout_rmse_mm": 1e3 * grid,
            "heldout_rmse_constant_mm": 1e3 * constant,
            "spread_between_cells_percent": (100 * g.spread).tolist(),
            "held_joints": list(g.held),
            "readings_per_cell": g.readings.tolist(),
        }
    if found.equilibrium_influence is not None:
        out["equilibrium_influence_share"] = {
            "mean": float(found.equilibrium_influence.mean()),
            "largest": float(found.equilibrium_influence.max()),
        }
    if found.monte_carlo is not None:
        out["monte_carlo_percent"] = [_finite(100 * v) for v in found.monte_carlo.spread]
    return IdentificationResult.model_validate(out)


def _scatter(found: Identification) -> dict[str, float | None]:
    s = found.scatter[0]

    def mm(value: float | None) -> float | None:
        return None if value is None else 1e3 * value

    return {"reading": mm(s.reading), "cycle": mm(s.cycle), "pose": mm(s.visit)}


def _ninety(found: Identification) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """90 % intervals of joints and of terms' coefficients, whatever level was asked for."""
    if found.uncertainty.level == CI90:
        return [j.interval for j in found.joints], [t.interval for t in found.terms]
    sure = uncertainty(found.fit, CI90)
    joints = [
        (min(float(low), j.k), max(float(high), j.k)) if j.identified else (float(low), float(high))
        for j, (low, high) in zip(found.joints, sure.stiffness_interval(), strict=True)
    ]
    return joints, [(float(low), float(high)) for low, high in sure.interval[6:]]


def _finite(value: float) -> float | None:
    return float(value) if isfinite(value) else None


def _facts(result: IdentificationResult) -> tuple[tuple[str, str], ...]:
    noise: dict[str, float | None] = result.noise_mm.plain()
    rows = [(name, str(value)) for name, value in result.options.plain().items()]
    rows += [
        (f"noise shared by a {name}" if name != "reading" else "noise of a reading", f"{value:.4f} mm")
        for name, value in noise.items()
        if value is not None
    ]
    rows += [("note", text) for text in result.notes]
    rows += list(result.inputs.items())
    return tuple(rows)


def _alike(found: Identification, cell: Cell) -> list[str]:
    """What stiffnesses that all differ by one factor from the cell's say of the record's units."""
    if cell.stiffness is None:
        return []
    known = [j for j in found.joints if j.identified]
    said = same_factor(np.array([j.k for j in known]), cell.stiffness.joints[[j.joint - 1 for j in known]])
    return [said] if said else []
