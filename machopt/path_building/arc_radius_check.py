"""Check of the radius of an arc against its centre and the radius that the file states."""

from __future__ import annotations

from machopt.path_building.arc_chords import RADIUS_FAULT, RADIUS_WARN, ArcChords, ArcError
from machopt.path_building.point_collector import PathBuilder


def check_radius(arc_chords: ArcChords, line: int, out: PathBuilder, stated: float | None = None) -> None:
    """Warn where start and end of an arc have different distances from its centre, or others than the radius stated.

    Args:
        arc_chords: Chords and radii of the arc, mm.
        line: Line number in the file (1-based).
        out: Path builder that takes the warning.
        stated: Radius that the record states, mm; it shows a wrong centre of a whole circle.

    Raises:
        ArcError: they differ by more than half a millimetre or a tenth of the radius.
    """
    if stated is not None and abs(stated - arc_chords.radius) > max(
        10.0 * RADIUS_WARN, RADIUS_FAULT * arc_chords.radius
    ):
        raise ArcError(f"the radius is {stated:.6g} mm, but the arc starts {arc_chords.radius:.6g} mm from its centre")
    off = abs(arc_chords.mismatch)
    if off > RADIUS_WARN and (off > RADIUS_FAULT * arc_chords.radius or off > 10.0 * RADIUS_WARN):
        raise ArcError(f"start and end of the arc differ by {off:.4g} mm in their distance from the centre")
    if off > RADIUS_WARN:
        out.warn_once("start and end of an arc differ by more than 0.05 mm in their distance from its centre", line)
