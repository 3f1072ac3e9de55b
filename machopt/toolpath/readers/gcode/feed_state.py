"""Feed of a control: per minute, per revolution or inverse time, in the unit in which it was programmed."""

from __future__ import annotations

import math

from machopt.file_formats.source_file import SourceFile
from machopt.path_building.point_collector import PathBuilder


class FeedState:
    """Feed that is in force, and the feed of a block."""

    siemens: bool  # whose control the program is for
    source: SourceFile
    out: PathBuilder
    rpm: float  # 1/min
    feed_mode: str  # "minute", "revolution" or "inverse"
    feed: float
    feed_unit: float  # mm per unit of an F that is programmed from here on; NaN: not known
    feed_scale: float  # mm per unit of ``feed``, which keeps what held when it was programmed
    last_feed: float  # mm/min
    fed_at: int  # line of the last F

    def reset_feed(self, scale: float) -> None:
        """Set the state of a control before its first F.

        Args:
            scale: mm per unit of the program.
        """
        self.feed_mode, self.feed, self.rpm = "minute", math.nan, math.nan
        self.feed_unit = self.feed_scale = scale
        self.last_feed = math.nan
        self.fed_at = 0

    def feed_outlives_its_unit(self) -> bool:
        """Whether F was programmed under the other of G20 and G21: controls differ in what it is then.

        Fanuc takes the number in the new unit, LinuxCNC keeps the speed; Sinumerik keeps the feed it has.
        """
        return not self.siemens and self.feed_scale != self.feed_unit and not math.isnan(self.feed)

    def feed_mm_min(self, length: float, line: int) -> float:
        """Compute the feed of a block.

        Args:
            length: Travel of the tool tip, mm.
            line: Line number in the file (1-based).

        Returns:
            Feed in mm/min; NaN where none is programmed.

        Raises:
            InputError: F precedes a change of unit, or must be in this block and is missing.
        """
        if self.feed_mode != "inverse":
            if self.feed_outlives_its_unit():
                own, new = (("inch" if unit > 1.0 else "mm") for unit in (self.feed_scale, self.feed_unit))
                raise self.source.build_error(
                    f"cuts by F{self.feed:g} of line {self.fed_at}, which was in {own}, and the program is in {new} "
                    f"since: some controls keep the speed, others the number; write F in {new} after that change",
                    line,
                )
            return self.feed * self.feed_scale * (self.rpm if self.feed_mode == "revolution" else 1.0)
        if self.fed_at != line and not self.siemens:  # of other controls F is for one block, and they alarm without
            raise self.source.build_error(
                "a cutting block without F under G93, where F (1/min) is for its own block", line
            )
        feed = self.feed * length  # G93: F is 1/min for the block
        if not (math.isfinite(feed) and feed > 1e-6):
            if math.isnan(self.feed) or math.isnan(self.last_feed):
                return math.nan
            self.out.warn_once("G93 blocks without travel of the tip keep the feed before them", line)
            return self.last_feed
        self.last_feed = feed
        return feed
