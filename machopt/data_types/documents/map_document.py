"""map.json of ``machopt map``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from machopt.data_types.documents.document_base import (
    Count,
    DocumentModel,
    First,
    Hashes,
    Known,
    Knowns,
    Number,
    Numbers,
    Text,
    check_literal_integer,
)


class MapAxisSection(DocumentModel):
    """One axis of the map, in ``unit``."""

    name: Text
    unit: Literal["deg", "mm"]
    first: Number = Field(validation_alias="from", serialization_alias="from")
    last: Number = Field(validation_alias="to", serialization_alias="to")
    step: Number
    count: Count


class MapLoadSection(DocumentModel):
    """The load whose deflection is mapped."""

    force_N: Numbers
    moment_Nm: Numbers
    axes: Text


class MapOptionsSection(DocumentModel):
    """Options as given; null where the kind of map has no such thing."""

    at_mm: Known
    tool_axis: Numbers | None
    gamma_deg: Known
    rotations: Count | None
    q_deg: Numbers | None
    pick: Text | Count
    by: Text
    collision: Text
    load: MapLoadSection | None
    limit_margin_deg: Number
    singularity_wrist_deg: Known
    singularity_elbow_deg: Known
    singularity_shoulder_mm: Known


class FieldExtremeSection(DocumentModel):
    """The sample where a field is least or greatest."""

    sample: Count
    xyz_mm: Knowns
    q_deg: Knowns


class MapFieldSection(DocumentModel):
    """Spread of one field over the samples with a posture; the unit is in the field's key."""

    name: Text
    better: Text | None
    min: Number
    p2: Number
    median: Number
    p98: Number
    max: Number
    at_min: FieldExtremeSection
    at_max: FieldExtremeSection


class MapLayerSection(DocumentModel):
    """One choice of rotation over all samples."""

    reached: Count
    reasons: dict[Text, Count]
    fields_of_layer: dict[Text, MapFieldSection | None] = Field(validation_alias="fields", serialization_alias="fields")


class RelativeErrorSection(DocumentModel):
    """Share of the measured stiffness: left-out readings, the model, and the diagonal of K."""

    left_out_rms: Known
    left_out_median: Known
    model_rms: Known
    model_median: Known
    held_rms: Known
    held_median: Known


class MeasuredStiffnessSection(DocumentModel):
    """Measured stiffness beside the model."""

    file: Text
    readings: Count
    power: Number
    neighbours: Count | None
    postures: Text
    relative_error: dict[Text, RelativeErrorSection]
    samples_inside_hull: Count


class MapDocument(DocumentModel):
    """The whole file."""

    machopt_map: First
    version: Text
    verdict: Text
    exit_code: Annotated[Literal[0, 3], BeforeValidator(check_literal_integer)]
    inputs: Hashes
    cell: Text
    kind: Text
    frame: Text
    axes: tuple[MapAxisSection, ...]
    samples: Count
    options: MapOptionsSection
    characteristic_length_mm: Number
    layers: dict[Text, MapLayerSection]
    measured: MeasuredStiffnessSection | None
    warnings: tuple[Text, ...]
