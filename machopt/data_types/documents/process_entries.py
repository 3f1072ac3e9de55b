"""Section of result.json about the process: tolerances, stock, stability and advised feeds."""

from __future__ import annotations

from machopt.data_types.documents.document_base import Count, DocumentModel, Known, Number, Text


class ToleranceEntry(DocumentModel):
    """Outcome of one operation with a tolerance."""

    operation: Text
    kind: Text  # holes or surface
    limits: dict[Text, Number]  # ±: position_mm, axis_deg, depth_mm, surface_mm
    reference: Text
    counts: dict[Text, Count]  # pass, marginal, fail, unknown
    worst_point: Count
    worst_error_mm: Known  # nominal: across the hole, or normal to the surface
    worst_p_in: Known
    worst_cause: Text


class OutcomeCountsSection(DocumentModel):
    """Number of points with each outcome: of the CAM file's rotation, of the source paper's method, of the plan."""

    before: dict[Text, Count]
    before_jiao2022: dict[Text, Count]
    after: dict[Text, Count]


class StockComparisonSection(DocumentModel):
    """Stock after the job against the workpiece of the cell, the finished part."""

    gouge_depth_mm: Number  # along the tool axis, along the normal of the part where the axis turns; away from walls
    gouge_at_mm: tuple[Number, Number, Number] | None  # in the workpiece frame
    gouge_volume_mm3: Number
    left_depth_mm: Number  # largest height of material left, away from walls
    left_at_mm: tuple[Number, Number, Number] | None
    left_volume_mm3: Number


class StockSection(DocumentModel):
    """What the job does to its stock."""

    cell_mm: Number
    volume_mm3: Number  # before the job
    removed_mm3: Number
    removed_by_other_moves_mm3: Number  # of it, by moves that are no cuts
    cut_moves: Count  # with engagement from the stock
    air_cuts: Count  # of them, that remove nothing
    finished: StockComparisonSection | None  # null without one closed mesh as workpiece


SHOWN_RANGES = 6  # of points, in a sentence


class StabilitySection(DocumentModel):
    """Stability of the milled points: stable depth of cut over the planned one."""

    min_stability_ratio: Known  # as requested; null: no limit
    least_ratio: Known  # null where no limit of the depth is near
    least_point: Count | None
    stable: Count  # points
    unstable: Count
    unknown: Count
    unknown_points: tuple[tuple[Count, Count], ...]  # rows of points with a posture, limit unknown: first and last

    def describe(self) -> str:
        """Return the stability of the job in one or two sentences."""
        total = self.stable + self.unstable + self.unknown
        text = f"{self.stable} of {total} milled points stable"
        text += f", {self.unknown} unknown" if self.unknown else ""
        if self.least_ratio is not None:
            text += f"; least ratio of stable to planned depth {self.least_ratio:.3g} at point {self.least_point}"
        least = self.min_stability_ratio
        if least is None:
            return text
        text += f" (min_stability_ratio {least:g})"
        return f"{text}. {self.describe_unchecked()}" if self.unknown_points else text

    def describe_unchecked(self) -> str:
        """Return at which points ``min_stability_ratio`` is not kept because their limit is unknown."""
        shown = ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in self.unknown_points[:SHOWN_RANGES])
        more = " and others" if len(self.unknown_points) > SHOWN_RANGES else ""
        count = sum(b - a + 1 for a, b in self.unknown_points)
        return (
            f"min_stability_ratio does not count at {count} points, whose limit of the depth of cut is unknown: "
            f"{shown}{more}"
        )


class AdvisedFeedSection(DocumentModel):
    """Feeds below those of the file, with `advised_feed_share`."""

    share: Number
    slowed: Count  # holes and milled points driven at an advice below the file's feed
    needed: Count  # holes and milled points out of tolerance at the file's feeds that an advice brings into it
    file_feed_s: Known  # cycle time at the feeds of the file


class ProcessSection(DocumentModel):
    """Tolerances of the job; errors at the feed that the motion reaches."""

    headline: Text
    quantile: Number  # probability that `pass` needs
    in_tolerance: OutcomeCountsSection
    tolerances: tuple[ToleranceEntry, ...]
    variance_shares: dict[Text, Number]  # stiffness, force, position: mean share of the variance of the error
    sources: dict[Text, Text]
    validity: tuple[Text, ...]
    stability: StabilitySection | None = None  # null where nothing is milled
    advised_feed: AdvisedFeedSection | None = None  # with `advised_feed_share`
    stock: StockSection | None = None  # null where no engagement comes from the stock
