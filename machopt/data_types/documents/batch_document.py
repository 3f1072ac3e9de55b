"""batch.json of a batch, and job.json and timing.json of each job."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from machopt.data_types.documents.document_base import Count, DocumentModel, First, Flag, Known, Number, Settings, Text


class JobNumbersSection(DocumentModel):
    """What a job came to; ``mean`` and ``worst`` are in ``unit``. Empty of a job without an answer."""

    points: Count | None = None
    infeasible_points: Count | None = None
    gain_percent: Known = None
    gain_std_percent: Known = None
    distinguishable: Flag | None = None
    gain_over_jiao2022_percent: Known = None
    unit: Literal["mm", "N/mm"] | None = None
    mean: Known = None
    worst: Known = None
    mean_cam_default: Known = None
    worst_cam_default: Known = None
    worst_point: Count | None = None
    deflection_mm: Known = None
    k_axial_N_mm: Known = None
    cycle_time_s: Known = None
    in_tolerance: Count | None = None  # holes and points that pass
    with_tolerance: Count | None = None  # holes and points that have one
    marginal: Count | None = None
    fail: Count | None = None
    unknown: Count | None = None
    worst_error_mm: Known = None  # at the hole or point with the lowest probability; empty where an angle decides
    worst_error_point: Count | None = None  # its toolpath point
    worst_p_in: Known = None  # its probability to be in tolerance
    programs: tuple[Text, ...] | None = None
    feed_held_percent: Known = None
    warnings: tuple[Text, ...] | None = None


class _JobVerdictSection(DocumentModel):
    exit_code: Count
    verdict: Text
    reason: Text


class BatchRowSection(JobNumbersSection, _JobVerdictSection):  # the keys of the last base come first
    """A job's verdict and its numbers."""


class BatchJobDocument(DocumentModel):
    """job.json: the same for the same job; what differs from run to run is in timing.json."""

    machopt_batch_job: First
    job: Text
    key: Text
    state: Text
    row: BatchRowSection
    files: tuple[Text, ...] = ()


class JobTimingDocument(DocumentModel):
    """timing.json: what a job took. It depends on the machine, so it is no part of the job's record."""

    wall_s: Number
    cpu_s: Number
    peak_MiB: Count
    worker: Text  # host and process


class JobFailureDocument(DocumentModel):
    """What a job leaves to its batch where an error ended it; where none did, it leaves its row."""

    error: Text  # the exception's name
    text: Text


class _JobIdentitySection(DocumentModel):
    rank: Count
    job: Text
    key: Text
    toolpath: Text
    cell: Text
    variant: Text
    options: Settings
    state: Text
    verdict: Text
    exit_code: Count | None = None
    reason: Text | None = None


class _JobFilesSection(DocumentModel):
    folder: Text
    report: Text


class BatchJobEntry(_JobFilesSection, JobNumbersSection, _JobIdentitySection):  # the keys of the last base come first
    """A line of batch.json: a job's place, what it is, its row and where its files are. A job that waits has no row."""


class BatchDifferenceEntry(DocumentModel):
    """A job of this batch beside the same one of another."""

    job: Text
    toolpath: Text
    variant: Text
    verdict_before: Text
    verdict: Text
    rotation_mean_deg: Known
    rotation_worst_deg: Known
    worst_at_point: Count | None
    turned_share: Known
    branch_changes: Count | None
    unit: Text | None
    mean_before: Known
    mean: Known
    worst_before: Known
    worst: Known
    cycle_time_before_s: Known
    cycle_time_s: Known
    note: Text


class BatchComparisonSection(DocumentModel):
    """This batch beside another one."""

    compared_with: Text = Field(validation_alias="with", serialization_alias="with")
    rows: tuple[BatchDifferenceEntry, ...]
    only_here: tuple[Text, ...]
    only_there: tuple[Text, ...]


class BatchDocument(DocumentModel):
    """batch.json: the same for the same jobs, however often the batch was stopped."""

    machopt_batch: First
    version: Text
    complete: Flag
    exit_code: Count | None
    counts: dict[Text, Count]
    jobs: tuple[BatchJobEntry, ...]
    left_out_files: tuple[Text, ...]
    other_jobs_in_folder: tuple[Text, ...]
    compare: BatchComparisonSection | None
