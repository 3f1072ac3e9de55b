"""map.json of ``machopt map``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from machopt.domain.results.base import Count, First, Hashes, Known, Knowns, Number, Numbers, Part, Text, whole


class AxisTold(Part):
    """One axis of the map, in ``unit``."""

    name: Text
    unit: Literal["deg", "mm"]
    first: Number = Field(validation_alias="from", serialization_alias="from")
    last: Number = Field(validation_alias="to", serialization_alias="to")
    step: Number
    count: Count


class LoadTold(Part):
    """The load whose deflection is mapped."""

    force_N: Numbers
    moment_Nm: Numbers
    axes: Text


class MapOptionsTold(Part):
    """As asked for; null where the kind of map has no such thing."""

    at_mm: Known
    tool_axis: Numbers | None
    gamma_deg: Known
    rotations: Count | None
    q_deg: Numbers | None
    pick: Text | Count
    by: Text
    collision: Text
    load: LoadTold | None
    limit_margin_deg: Number
    singularity_wrist_deg: Known
    singularity_elbow_deg: Known
    singularity_shoulder_mm: Known


class Extreme(Part):
    """The sample where a field is least or greatest."""

    sample: Count
    xyz_mm: Knowns
    q_deg: Knowns


class FieldTold(Part):
    """Spread of one field over the samples with a posture; the unit stands in the field's key."""

    name: Text
    better: Text | None
    min: Number
    p2: Number
    median: Number
    p98: Number
    max: Number
    at_min: Extreme
    at_max: Extreme


class LayerTold(Part):
    """One choice of rotation over all samples."""

    reached: Count
    reasons: dict[Text, Count]
    fields_of_layer: dict[Text, FieldTold | None] = Field(validation_alias="fields", serialization_alias="fields")


class RelativeError(Part):
    """Share of the measured stiffness: left-out readings, the model, and the diagonal of K."""

    left_out_rms: Known
    left_out_median: Known
    model_rms: Known
    model_median: Known
    held_rms: Known
    held_median: Known


class MeasuredTold(Part):
    """Measured stiffness beside the model."""

    file: Text
    readings: Count
    power: Number
    neighbours: Count | None
    postures: Text
    relative_error: dict[Text, RelativeError]
    samples_inside_hull: Count


class MapResult(Part):
    """The whole file."""

    machopt_map: First
    version: Text
    verdict: Text
    exit_code: Annotated[Literal[0, 3], BeforeValidator(whole)]
    inputs: Hashes
    cell: Text
    kind: Text
    frame: Text
    axes: tuple[AxisTold, ...]
    samples: Count
    options: MapOptionsTold
    characteristic_length_mm: Number
    layers: dict[Text, LayerTold]
    measured: MeasuredTold | None
    warnings: tuple[Text, ...]
