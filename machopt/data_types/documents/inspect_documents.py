"""JSON output of ``machopt inspect --json``: of a toolpath, of a cell, of a robot."""

from __future__ import annotations

from machopt.data_types.documents.document_base import Count, DocumentModel, Known, Number, Numbers, Text
from machopt.data_types.documents.optimize_document import IgnoredWordEntry


class BoxSection(DocumentModel):
    """A box along the axes of the toolpath's own frame, mm."""

    min: Numbers
    max: Numbers


class InspectedOperationEntry(DocumentModel):
    """One operation; ``feed_mm_min`` least and greatest of its cuts, null where no cut has a feed."""

    label: Text
    kind: Text
    tool: Text
    points: Count
    cutting_points: Count
    feed_mm_min: tuple[Number, Number] | None
    first_line: Count | None  # null: it has no point


class InspectedToolpathDocument(DocumentModel):
    """A CAM file or robot program as it was read; ranges are least and greatest, null where nothing is known."""

    source: Text
    format: Text
    sha256: Text
    unit: Text
    meta: dict[Text, Text]
    points: Count
    moves: dict[Text, Count]
    length_mm: dict[Text, Number]
    operations: tuple[InspectedOperationEntry, ...]
    extent_mm: BoxSection
    cutting_extent_mm: BoxSection
    feed_mm_min: tuple[Number, Number] | None
    tilt_deg: tuple[Number, Number] | None
    events: dict[Text, Count]
    ignored: tuple[IgnoredWordEntry, ...]
    incomplete: Text | None  # why the file seems to end too early
    warnings: tuple[Text, ...]


class RobotJointEntry(DocumentModel):
    """A joint of a URDF: in degrees, a prismatic one in mm; null where the file states no limit."""

    name: Text
    kind: Text
    parent: Text
    child: Text
    lower_deg: Known = None
    upper_deg: Known = None
    velocity_deg_s: Known = None
    lower_mm: Known = None
    upper_mm: Known = None
    velocity_mm_s: Known = None
    mimics: Text = ""
    multiplier: Number = 1.0
    offset_deg: Number = 0.0


class InspectedRobotDocument(DocumentModel):
    """A robot's URDF or xacro file without a cell."""

    robot: Text
    links: Count
    collision_bodies: Count
    mass_kg: Number
    joints: tuple[RobotJointEntry, ...]
    warnings: tuple[Text, ...]
    not_used: dict[Text, Count]


class MountingSection(DocumentModel):
    """Pose of ``base_link`` in the world; ``down_in_base`` is the unit vector of gravity in ``base_link``."""

    stands: Text
    tilt_deg: Number
    xyz_mm: Numbers
    down_in_base: Numbers


class CellJointEntry(DocumentModel):
    """An arm's or external joint with the limits in force: in degrees, a prismatic one in mm; null: without limit."""

    name: Text
    lower_deg: Known = None
    upper_deg: Known = None
    home_deg: Known = None
    velocity_deg_s: Known = None
    acceleration_deg_s2: Known = None
    jerk_deg_s3: Known = None
    lower_mm: Known = None
    upper_mm: Known = None
    home_mm: Known = None
    velocity_mm_s: Known = None
    acceleration_mm_s2: Known = None
    jerk_mm_s3: Known = None


class MimicJointEntry(DocumentModel):
    """A joint that follows another: ``multiplier`` × its angle + ``offset`` (rad, m)."""

    name: Text
    mimics: Text
    multiplier: Number
    offset: Number


class IgnoredPairEntry(DocumentModel):
    """Two bodies that may touch, and why."""

    a: Text
    b: Text
    why: Text


class InspectedCellDocument(DocumentModel):
    """A cell; what follows from a model is left out where ``cannot_be_planned`` says why there is none."""

    cell: Text
    robot: Text
    mounting: MountingSection
    joints: tuple[CellJointEntry, ...]
    followers: tuple[MimicJointEntry, ...]
    inverse_kinematics: Text = ""
    moving_mass_kg: Number = 0.0
    pairs_checked: Count = 0
    pairs_ignored: tuple[IgnoredPairEntry, ...] = ()
    touching_at_home: tuple[tuple[Text, Text], ...] = ()
    cannot_be_planned: Text = ""
    warnings: tuple[Text, ...]
    notes: tuple[Text, ...]
