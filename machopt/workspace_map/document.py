"""Result document of a map: map.json, its layers, the verdict for the user."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.documents.map_document import (
    FieldExtremeSection,
    MapAxisSection,
    MapDocument,
    MapFieldSection,
    MapLayerSection,
    MapLoadSection,
    MapOptionsSection,
    MeasuredStiffnessSection,
    RelativeErrorSection,
)
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform
from machopt.version import __version__
from machopt.workspace_map.measured_stiffness import MeasuredComparison
from machopt.workspace_map.postures import MapPostures, ReachingArm
from machopt.workspace_map.quantities import MapQuantity, MapSettings, QuantityUnit
from machopt.workspace_map.quantity_evaluation import QuantityValues
from machopt.workspace_map.request import MapOptions
from machopt.workspace_map.sample_grid import MapSamples, compute_farthest_reach

MM, DEG = 1e3, float(np.degrees(1.0))
COLUMN_SUFFIXES: dict[QuantityUnit, tuple[str, float]] = {
    "N/m": ("_N_mm", 1e-3),
    "m": ("_mm", MM),
    "rad": ("_deg", DEG),
    "1": ("", 1.0),
}
"""What a unit of the fields is called in files, and the factor to it."""

LARGE_DEFLECTION_M = 0.02  # m; deflection above the validity limit of linear elasticity

REASON_TEXTS = {
    InfeasibilityReason.OK: "posture found",
    InfeasibilityReason.UNREACHABLE: "out of reach",
    InfeasibilityReason.LIMIT: "beyond a joint limit",
    InfeasibilityReason.SINGULAR_WRIST: "wrist too near its singularity",
    InfeasibilityReason.SINGULAR_ELBOW: "elbow too near its singularity",
    InfeasibilityReason.SINGULAR_SHOULDER: "wrist too near axis 1",
    InfeasibilityReason.COLLIDING: "collides",
    InfeasibilityReason.BOUNDS: "in another branch only",
    InfeasibilityReason.NO_PATH: "only by a jump",
}


@dataclass(frozen=True)
class MapLayerResult:
    """One choice of rotation over all samples."""

    name: str  # "given" or "free"
    postures: MapPostures
    values: QuantityValues


@dataclass(frozen=True, kw_only=True)
class EvaluatedMap:
    """A map with its inputs and the quantities at its samples."""

    cell: Cell
    options: MapOptions
    setting: MapSettings  # constant inputs of the quantities
    samples: MapSamples
    arm: ReachingArm  # kinematics, limits, margins
    layers: list[MapLayerResult]  # the given rotation first
    criterion: MapQuantity  # by which postures are selected
    comparison: MeasuredComparison | None  # with measured stiffness; None: none


def build_column_name(field: MapQuantity) -> str:
    """Return the name of a quantity's column in files.

    Args:
        field: quantity.
    """
    return field.key + COLUMN_SUFFIXES[field.unit][0]


def convert_to_map_frame(T_base_tcp: Array, options: MapOptions) -> Array:
    """Return TCP poses (..., 4, 4) in the map's frame.

    Args:
        T_base_tcp: (..., 4, 4) in base_link.
        options: map options with the frame.
    """
    return np.asarray(invert_transform(options.T_base_frame) @ T_base_tcp)


def compute_sample_positions(samples: MapSamples, layer: MapLayerResult, options: MapOptions) -> Array:
    """Return (M, 3) m, the actual or requested TCP position of each sample in the map's frame; NaN where there is none.

    Args:
        samples: samples of the map.
        layer: layer with the postures.
        options: map options with the frame.
    """
    return (
        convert_to_map_frame(layer.values.T_base_tcp, options)[:, :3, 3]
        if samples.position is None
        else samples.position
    )


def build_map_document(evaluated: EvaluatedMap, inputs: dict[str, str], plan: PlanOptions) -> tuple[MapDocument, str]:
    """Return map.json, and its verdict as one sentence.

    Args:
        evaluated: the map with its inputs.
        inputs: SHA-256 of each input file by name.
        plan: plan options with the margins.
    """
    cell, options, setting, comparison = evaluated.cell, evaluated.options, evaluated.setting, evaluated.comparison
    samples, layers = evaluated.samples, evaluated.layers
    message = _format_verdict(evaluated)
    angle = options.kind == "joints"
    scale = DEG if angle else MM
    result = MapDocument(
        machopt_map=1,
        version=__version__,
        verdict=message,
        exit_code=0 if any(layer.postures.ok.any() for layer in layers) else 3,
        inputs=inputs,
        cell=cell.name,
        kind=samples.kind,
        frame=options.frame,
        axes=tuple(
            MapAxisSection(
                name=a.name,
                unit="deg" if angle else "mm",
                first=_round_value(a.values[0] * scale),
                last=_round_value(a.values[-1] * scale),
                step=_round_value((a.values[1] - a.values[0]) * scale),
                count=len(a.values),
            )
            for a in samples.axes
        ),
        samples=len(samples),
        options=_build_options_section(plan, options, setting, evaluated.criterion),
        characteristic_length_mm=setting.length * MM,
        layers={layer.name: _build_layer_entry(samples, layer, options) for layer in layers},
        measured=None if comparison is None else _build_measured_section(comparison),
        warnings=(*cell.warnings, *_list_hints(samples, layers, setting), *(comparison.warnings if comparison else ())),
    )
    return result, message


def _build_options_section(
    plan: PlanOptions, options: MapOptions, setting: MapSettings, criterion: MapQuantity
) -> MapOptionsSection:
    angle, load = options.kind == "joints", setting.load
    return MapOptionsSection(
        at_mm=_round_value(options.at * MM) if options.kind == "slice" else None,
        tool_axis=None if angle else tuple(_round_value(v) for v in options.tool_axis.tolist()),
        gamma_deg=None if angle else _round_value(options.gamma[0] * DEG),
        rotations=None if angle else len(options.gamma),
        q_deg=tuple(_round_value(v) for v in (options.q * DEG).tolist()) if angle else None,
        pick=options.pick,
        by=criterion.key,
        collision=options.collision,
        load=None
        if load is None
        else MapLoadSection(
            force_N=tuple(load.wrench[:3].tolist()), moment_Nm=tuple(load.wrench[3:].tolist()), axes=load.axes
        ),
        limit_margin_deg=0.0 if angle else _round_value(plan.limit_margin * DEG),
        singularity_wrist_deg=None if angle else _round_value(plan.singularity_wrist * DEG),
        singularity_elbow_deg=None if angle else _round_value(plan.singularity_elbow * DEG),
        singularity_shoulder_mm=None if angle else _round_value(plan.singularity_shoulder * MM),
    )


def compute_statistics(value: Array) -> dict[str, float] | None:
    """Return extremes and percentiles of a quantity in SI, with the rows of the extremes; None without numbers.

    Args:
        value: (M,) SI, NaN where there is none.
    """
    known = np.flatnonzero(np.isfinite(value))
    if not len(known):
        return None
    v = value[known]
    low, p2, median, p98, high = np.percentile(v, [0, 2, 50, 98, 100])
    return {
        "min": float(low),
        "p2": float(p2),
        "median": float(median),
        "p98": float(p98),
        "max": float(high),
        "at_min": int(known[np.argmin(v)]),
        "at_max": int(known[np.argmax(v)]),
        "count": len(known),
    }


def _build_layer_entry(samples: MapSamples, layer: MapLayerResult, options: MapOptions) -> MapLayerSection:
    p, v = layer.postures, layer.values
    place = compute_sample_positions(samples, layer, options)
    codes, counts = np.unique(p.reason, return_counts=True)

    def extreme(row: float) -> FieldExtremeSection:
        at = int(row)
        return FieldExtremeSection(sample=at, xyz_mm=(place[at] * MM).round(3), q_deg=(p.q[at] * DEG).round(4))

    fields: dict[str, MapFieldSection | None] = {}
    for field in v.fields:
        found = compute_statistics(v.value[field.key])
        factor = COLUMN_SUFFIXES[field.unit][1]
        fields[build_column_name(field)] = (
            None
            if found is None
            else MapFieldSection(
                name=field.name,
                better=field.better,
                **{name: found[name] * factor for name in ("min", "p2", "median", "p98", "max")},
                at_min=extreme(found["at_min"]),
                at_max=extreme(found["at_max"]),
            )
        )
    return MapLayerSection(
        reached=int(p.ok.sum()),
        reasons={InfeasibilityReason(c).word: int(n) for c, n in zip(codes.tolist(), counts.tolist(), strict=True)},
        fields_of_layer=fields,
    )


def _build_measured_section(c: MeasuredComparison) -> MeasuredStiffnessSection:
    return MeasuredStiffnessSection(
        file=c.file,
        readings=len(c.position),
        power=c.power,
        neighbours=c.neighbours,
        postures="of the table" if c.from_joints else "of the map's own choice",
        relative_error={f"k{axis}": RelativeErrorSection(**row) for axis, row in c.compute_errors().items()},
        samples_inside_hull=int(c.spread.inside.sum()),
    )


def _format_verdict(evaluated: EvaluatedMap) -> str:
    samples, criterion, arm, options = evaluated.samples, evaluated.criterion, evaluated.arm, evaluated.options
    most = max(evaluated.layers, key=lambda layer: int(layer.postures.ok.sum()))
    count = int(most.postures.ok.sum())
    if count == 0:
        reasons = np.bincount(most.postures.reason)
        worst = InfeasibilityReason(int(np.argmax(reasons)))
        centre, radius = compute_farthest_reach(arm.robot, arm.T_flange_tcp)
        T = invert_transform(options.T_base_frame)
        middle = (T[:3, :3] @ centre + T[:3, 3]) * MM
        verdict = f"none of {len(samples):,} samples has a posture; most are {REASON_TEXTS[worst]}"
        if samples.q is not None:
            return f"{verdict}: the joint limits are {_format_limit_note(evaluated.setting)}"
        short = most.postures.shortfall[most.postures.shortfall > 0]
        miss = (
            f", the nearest by {short.min() * MM:.0f} mm"
            if worst == InfeasibilityReason.UNREACHABLE and len(short)
            else ""
        )
        return (
            f"{verdict}{miss}; the tool tip never gets further than {radius * MM:.0f} mm from x {middle[0]:.0f}, "
            f"y {middle[1]:.0f}, z {middle[2]:.0f} mm of {options.frame}"
        )
    unit, factor = COLUMN_SUFFIXES[criterion.unit]
    found = compute_statistics(most.values.value[criterion.key])
    share = f"{100 * count / len(samples):.0f} % of {len(samples):,} samples have a posture"
    if found is None:
        return share
    word = unit.replace("_N_mm", " N/mm").replace("_", " ")
    spread = f"{criterion.name[0].lower()}{criterion.name[1:]} {_format_number(found['min'] * factor)} to "
    median = _format_number(found["median"] * factor)
    return f"{share}; {spread}{_format_number(found['max'] * factor)}{word}, median {median}"


def _format_limit_note(setting: MapSettings) -> str:
    pairs = zip(setting.robot.joints, setting.lower * DEG, setting.upper * DEG, strict=True)
    return ", ".join(f"{name} {low:.4g} to {high:.4g}" for name, low, high in pairs) + " deg"


def _format_external_joints(setting: MapSettings) -> list[str]:
    names = [s.joint for s in setting.elasticity.stiffness.external if s.is_compliant] if setting.elasticity else []
    if not names:
        return []
    return [
        f"external joints stand at home, and what {', '.join(names)} give there counts in at every place, as if the "
        "part were there"
    ]


def _list_hints(samples: MapSamples, layers: list[MapLayerResult], setting: MapSettings) -> list[str]:
    out = []
    if setting.elasticity is None:
        out.append("the cell has no stiffness: only dexterity and distance from the limits are mapped")
    else:
        out += setting.elasticity.warnings
        d = setting.elasticity.stiffness.discrepancy
        out += [misfit] if d is not None and (misfit := d.describe_misfit("Stiffness and deflection")) else []
        out += [*_format_external_joints(setting), *setting.job_notes]
    for layer in layers:
        if "deflection" not in layer.values.value:
            break
        bent = layer.values.value["deflection"][layer.postures.ok]
        if np.isfinite(bent).any() and np.nanmedian(bent) > LARGE_DEFLECTION_M:
            out.append(
                f"the load bends the arm by {np.nanmedian(bent) * MM:,.0f} mm (median, {layer.name} layer), "
                "more than linear elasticity holds for; is it in N?"
            )
        if len(bent) and np.isnan(bent).any():
            out.append(
                f"at {100 * np.isnan(bent).mean():.0f} % of the {layer.name} layer the springs do not hold "
                "the load: with geometric_stiffness the arm would buckle"
            )
    dexterity = layers[0].values.value["dexterity"]
    if samples.kind == "joints" and np.isfinite(dexterity).any() and np.nanmax(dexterity) < 0.02:
        out.append(
            "every posture is all but singular: the fixed joints are (often a straight wrist); --q with the "
            "wrist at 45 deg shows the others' part"
        )
    for layer in layers:
        grid = layer.values.is_in_grid
        if grid is not None and layer.postures.ok.any() and not grid[layer.postures.ok].all():
            share = 1 - grid[layer.postures.ok].mean()
            out.append(
                f"{100 * share:.0f} % of the {layer.name} layer lies outside the stiffness grid, where the "
                "constant values hold"
            )
    if samples.kind == "line":
        for layer in layers:
            jumps = int((layer.postures.reason == InfeasibilityReason.NO_PATH).sum())
            if jumps:
                out.append(
                    f"{layer.name} rotation: no unbroken branch along the whole line ({jumps} samples would be "
                    "reached only by a jump); a finer --step shows whether the jump is real"
                )
    return out


def _round_value(value: float) -> float:
    return float(f"{value:.9g}")


def _format_number(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
