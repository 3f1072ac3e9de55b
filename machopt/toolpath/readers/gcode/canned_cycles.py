"""Canned cycles: G73 to G89 and Sinumerik's CYCLE81 to CYCLE89."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from machopt.file_formats.plain_decimals import parse_plain_decimal
from machopt.path_building.drilling_cycles import DrillingCycle, DrillingCycleError
from machopt.toolpath.readers.gcode.syntax.blocks import ProgramBlock
from machopt.toolpath.readers.gcode.syntax.dwell_units import Control, convert_dwell

_FEED_OUT = {74, 84, 85, 89}
_PECK = {73, 83}
_DWELLING = tuple(f"CYCLE8{n}" for n in (2, 3, 4, 5, 6, 8, 9))
# places of AMODE; DMODE and GMODE are before it
_DEPTH_MODES = {"CYCLE81": 8, "CYCLE82": 8, "CYCLE83": 19, "CYCLE84": 23, "CYCLE840": 19, "CYCLE85": 10}
_DEPTH_MODES |= {"CYCLE86": 13, "CYCLE89": 8}
_TIP_MODES = ("CYCLE81", "CYCLE82", "CYCLE83")  # their GMODE says what the depth counts to
_THREAD_NAMES = {"CYCLE84": (18, 21), "CYCLE840": (14, 17)}  # places of PITM, PTAB and PTABA: texts
_SAME_DEPTH = 1e-6  # of a unit
SIEMENS = re.compile(r"CYCLE(?:8[1-9]|840)")


@dataclass(kw_only=True)
class CannedCycle:
    """Modal words of a G cycle; absolute heights in mm."""

    code: int = 0
    z: float | None = None
    r: float | None = None
    q: float = 0.0
    dwell: float = 0.0  # s; NaN: its unit is not known
    initial: float = 0.0  # height at which the cycle was begun, for G98
    depth: str = "Z"  # letter of the axis that it drills along
    counted: bool = False  # its heights were given under G91

    def take_words(
        self, words: dict[str, float], b: ProgramBlock, scale: float, *, depth: str, incremental: bool, control: Control
    ) -> None:
        """The cycle's own words of one block; under G91, R counts from the initial height and the depth from R.

        Args:
            words, b: of the block; what belongs to the cycle is taken out of ``words``.
            scale: mm per unit.
            depth: letter of the axis that it drills along.
            incremental: G91 holds.
            control: whose unit a dwell without a decimal point has.
        """
        self.depth = depth
        if "R" in words or depth in words:
            self.counted = incremental
        if "R" in words:
            self.r = words.pop("R") * scale + (self.initial if incremental else 0.0)
        if depth in words:
            self.z = words.pop(depth) * scale + ((self.r or 0.0) if incremental else 0.0)
        for name in ("R2", "CR"):  # cycles of older Siemens controls: reference plane (posts also write it as CR)
            if name in b.named:
                self.r = b.named[name] * scale
        if "R3" in b.named:
            self.z = b.named["R3"] * scale
        if "R10" in b.named:
            self.initial = b.named["R10"] * scale
        if "Q" in words:
            self.q = abs(words.pop("Q")) * scale
        if "P" in words:
            self.dwell = convert_dwell(words.pop("P"), letter="P", bare=b.bare("P"), control=control)

    def build_cycle_at_hole(self, *, back_to_initial: bool) -> DrillingCycle:
        """Build the strokes of the cycle with heights over the plane z = 0.

        Args:
            back_to_initial: Whether the tool retracts to the initial level (G98) instead of the R plane (G99).

        Returns:
            The drilling cycle, heights in mm.

        Raises:
            DrillingCycleError: Z or R was never given.
        """
        if self.z is None or self.r is None:
            letter, what = (self.depth, "the depth") if self.z is None else ("R", "the height the feed begins at")
            raise DrillingCycleError(
                f"G{self.code} without {letter}: {what} is not stated; post the cycle with its {letter}"
            )
        if self.code == 87 and self.z > self.r:
            raise DrillingCycleError(
                "G87 is back boring: which way the tool is shifted beside the hole is a parameter of the control; post "
                "the hole as G0 and G1"
            )
        return DrillingCycle(
            name=f"G{self.code}",
            bottom=self.z,
            clear=self.r,
            retract=max(self.initial, self.r) if back_to_initial else self.r,
            feed=math.nan,
            first_peck=self.q if self.code in _PECK else 0.0,
            chip_break=self.code == 73,
            feed_out=self.code in _FEED_OUT,
            dwell=self.dwell,
            peck_from=self.r,
        )


# ISO 261, coarse series: nominal diameter → pitch, mm
_COARSE_PITCH: dict[float, float] = dict(
    zip(
        (3, 4, 5, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 27, 30, 33, 36, 39, 42, 45, 48),
        (0.5, 0.7, 0.8, 1, 1.25, 1.5, 1.75, 2, 2, 2.5, 2.5, 2.5, 3, 3, 3.5, 3.5, 4, 4, 4.5, 4.5, 5),
        strict=True,
    )
)


def _compute_tapping_feeds(
    name: str, text: str, values: list[float | None], scale: float, rpm: float
) -> tuple[float | None, float | None]:
    """Feeds in and out of CYCLE84 and CYCLE840, mm/min: pitch PIT or thread size MPIT times the speeds SST and SST1.

    CYCLE840 has no speeds of its own. None where pitch or speed are not stated: the feed in force holds.
    """
    if name not in ("CYCLE84", "CYCLE840"):
        return None, None
    size, pitch = values[7:9] if name == "CYCLE84" else values[9:11]
    if not pitch and size:
        pitch_mm = _COARSE_PITCH.get(abs(size))
        if pitch_mm is None:
            raise DrillingCycleError(f"{name}: thread size M{abs(size):g} is not in the coarse series; give the pitch")
    elif pitch:
        pitch_mm = _convert_pitch(name, abs(pitch), values[13 if name == "CYCLE84" else 12], scale)
    elif table := _read_thread_name(name, text):
        raise DrillingCycleError(f"{name}: the pitch of {table} is not stated; expected the argument PIT")
    else:
        return None, None
    speed, speed_out = (values[10], values[11]) if name == "CYCLE84" else (None, None)
    speed = speed or (rpm if rpm > 0.0 else None)
    if not speed:
        return None, None
    return pitch_mm * speed, pitch_mm * (speed_out or speed)


def _convert_pitch(name: str, pitch: float, unit: float | None, scale: float) -> float:
    """Pitch in mm per turn; PITA: 0 or none in the unit of the program, 1 mm, 2 threads per inch, 3 inch per turn."""
    if not unit:
        return pitch * scale
    if unit == 1:
        return pitch
    if unit == 2:
        return 25.4 / pitch
    if unit == 3:
        return 25.4 * pitch
    raise DrillingCycleError(
        f"{name}: PITA={unit:g} is no unit of the pitch; expected 0, 1 (mm), 2 (1/inch) or 3 (inch)"
    )


def _parse_cycle_arguments(name: str, text: str) -> list[float | None]:
    """The 24 arguments of a cycle, None where one is left out or names a thread."""
    values: list[float | None] = []
    first, last = _THREAD_NAMES.get(name, (0, 0))
    for place, part in enumerate(map(str.strip, text.split(","))):
        is_text = first <= place < last and len(part) > 1 and part[0] == part[-1] == '"'
        try:
            values.append(parse_plain_decimal(part) if part and not is_text else None)
        except ValueError:
            raise DrillingCycleError(f"{name}: argument {part!r} is not a number") from None
    return values + [None] * (24 - len(values))


def _read_thread_name(name: str, text: str) -> str:
    """Return the thread that PTAB and PTABA name, such as M10; empty where none is named."""
    first, last = _THREAD_NAMES[name]
    return " ".join(filter(None, (part.strip(' "') for part in text.split(",")[first + 1 : last])))


def check_plane_mode(name: str, mode: float, plane: int) -> None:
    """Refuse a _DMODE that names another plane than the one in force.

    Args:
        name: Name of the cycle.
        mode: The argument _DMODE; its last digit: 0 the plane in force, 1 G17, 2 G18, 3 G19.
        plane: The plane in force: 17, 18 or 19.

    Raises:
        DrillingCycleError: it names another plane, or is no whole number.
    """
    digit = mode % 10
    if digit not in (0.0, plane - 16.0):
        raise DrillingCycleError(
            f"{name}: _DMODE {mode:g} names another plane than G{plane}, which is in force; expected 0 or {plane - 16}"
        )


def _check_stated_twice(name: str, values: list[float | None]) -> None:
    """Refuse a depth that is stated as DP and as DPR where both differ; a relative depth of zero counts as none."""
    surface = values[1]
    places = [("DP", "DPR", 3)] + ([("FDEP", "FDPR", 5)] if name == "CYCLE83" else [])
    for absolute, relative, at in places:
        depth, below = values[at : at + 2]
        if at == 3 and name in _DEPTH_MODES and (values[_DEPTH_MODES[name]] or 0.0) % 10:
            continue  # AMODE says which of both counts
        if surface is None or depth is None or not below:
            continue
        if abs(surface - abs(below) - depth) > _SAME_DEPTH:
            raise DrillingCycleError(
                f"{name}: {absolute}={depth:g} and {relative}={below:g} are different depths (reference plane "
                f"{surface:g}). Write only the one that counts"
            )


def _check_depth_modes(name: str, values: list[float | None]) -> None:
    """Refuse modes under which DP and DPR mean something else: GMODE (shank or diameter) and AMODE (which of both)."""
    _check_stated_twice(name, values)
    if name not in _DEPTH_MODES:
        return
    of_depth = _DEPTH_MODES[name]
    of_tip = of_depth - 2
    if name in _TIP_MODES and values[of_tip]:
        raise DrillingCycleError(
            f"{name}: GMODE={values[of_tip]:g} counts the depth to the shank, or by a diameter. Write the depth "
            "of the tip and GMODE 0"
        )
    kind = (values[of_depth] or 0.0) % 10
    if (kind == 1.0 and values[3] is not None) or (kind == 2.0 and values[3] is None):
        raise DrillingCycleError(
            f"{name}: AMODE={values[of_depth]:g} says that the depth is {'DPR' if kind == 1.0 else 'DP'}; found the "
            "other one. Write only the one that counts"
        )


@dataclass(frozen=True, kw_only=True)
class _CyclePecks:
    """Pecks of a drilling or tapping cycle, in units of the program."""

    first: float = 0.0  # first depth below the reference plane
    chip_break: bool = False
    gap: float = 0.0  # way back (VRT), or distance before the feed begins again (DIS1)
    synchronous: bool = False  # tapped step by step
    less: float = 0.0  # length by which each peck is shorter
    share: float = 1.0  # of the peck before
    least: float = 0.0
    first_feed: float = 1.0  # share of the feed for the first peck


def _parse_pecks(name: str, values: list[float | None], rfp: float) -> _CyclePecks:
    """Return the pecks of CYCLE83 (FDEP, FDPR, DAM, FRF, VARI, DIS1 or VRT) and CYCLE84 (_VARI, _DAM, _VRT)."""
    if name == "CYCLE84" and (values[15] or 0.0) % 10 in (1.0, 2.0) and (values[16] or 0.0) > 0.0:
        return _CyclePecks(
            first=values[16] or 0.0,
            chip_break=(values[15] or 0.0) % 10 == 1.0,
            gap=abs(values[17] or 0.0),
            synchronous=True,
        )
    if name != "CYCLE83":
        return _CyclePecks()
    degression, slower = values[7] or 0.0, values[10] or 1.0
    if not (degression >= -1.0 and 0.0 < slower <= 100.0):
        raise DrillingCycleError(
            f"{name}: DAM {degression:g}, FRF {slower:g}; expected a length by which pecks get shorter, or their share "
            "as -0.001 to -1, and a share of the feed, 0.001 to 1 or in percent"
        )
    chip_break = values[11] in (0.0, None)
    return _CyclePecks(
        first=rfp - values[5] if values[5] is not None else abs(values[6] or 0.0),
        chip_break=chip_break,
        gap=abs(values[14 if chip_break else 16] or 0.0),
        less=max(degression, 0.0),
        share=-degression if degression < 0.0 else 1.0,
        least=max(values[13] or 0.0, 0.0),
        first_feed=slower if slower <= 1.0 else slower / 100.0,
    )


def parse_siemens_cycle(name: str, text: str, scale: float, rpm: float = math.nan, plane: int = 17) -> DrillingCycle:
    """Parse ``CYCLE8x(RTP, RFP, SDIS, DP, DPR, …)``; its feed is the feed that is active at each hole.

    Args:
        name: Name of the cycle.
        text: Text of its arguments.
        scale: mm per unit of the program.
        rpm: Spindle speed in force, 1/min; NaN where none is.
        plane: Working plane in force: 17, 18 or 19.

    Returns:
        The drilling cycle with heights over the plane z = 0, mm.

    Raises:
        DrillingCycleError: an argument is invalid, or depth or planes are missing.
    """
    values = _parse_cycle_arguments(name, text)
    _check_depth_modes(name, values)
    if name in _DEPTH_MODES:
        check_plane_mode(name, values[_DEPTH_MODES[name] - 1] or 0.0, plane)
    rtp, rfp, sdis, dp, dpr = values[:5]
    if rtp is None or rfp is None or (dp is None and dpr is None):
        raise DrillingCycleError(f"{name}: expected retract plane, reference plane, safety distance and depth")
    bottom = dp if dp is not None else rfp - abs(dpr or 0.0)
    dwell = values[8 if name == "CYCLE83" else 5] or 0.0  # DTB
    pecks = _parse_pecks(name, values, rfp)
    way_in, way_out = _compute_tapping_feeds(name, text, values, scale, rpm)
    if name == "CYCLE85":  # FFR, RFF
        way_in, way_out = ((v or 0.0) * scale for v in values[6:8])
    return DrillingCycle(
        name=name,
        bottom=bottom * scale,
        surface=rfp * scale,
        clear=(rfp + abs(sdis or 0.0)) * scale,
        retract=max(rtp, rfp + abs(sdis or 0.0)) * scale,
        feed=way_in or math.nan,
        feed_back=way_out or math.nan,
        first_peck=max(pecks.first, 0.0) * scale,
        chip_break=pecks.chip_break,
        gap=pecks.gap * scale or 1.0,
        synchronous=pecks.synchronous,
        less=pecks.less * scale,
        share=pecks.share,
        least_peck=pecks.least * scale,
        first_feed=pecks.first_feed,
        feed_out=name in ("CYCLE84", "CYCLE840", "CYCLE85", "CYCLE89"),
        dwell=dwell if name in _DWELLING else 0.0,
        peck_from=rfp * scale,
    )
