"""``programs`` of result.json held against manifest, files and what reading them back gives."""

from __future__ import annotations

from collections.abc import Iterable

from machopt.domain.results.optimize import ProgramTold
from machopt.domain.stint import Stint
from machopt.formats.toolchoice import stints_of
from machopt.recheck.compared import Compared, Posted
from machopt.recheck.posts import post_of, to_be_told
from machopt.recheck.told import AGREE, DIGITS, Told, is_file, near, same, short

PROGRAM_ROOM = 1e-4  # mm, deg, mm/min: what rounding moves a measured difference by


def programs(t: Told) -> Iterable[str]:
    told = t.result.programs
    there = {f.name for f in t.manifest.files if f.role == "program"} if t.manifest else None
    named = [name for p in told for name in p.files]
    for p in told:
        if p.files:
            lines = sum((t.folder / name).read_bytes().count(b"\n") for name in p.files if is_file(t, name))
            yield from same(f"{p.post}: lines", p.lines, lines)
            yield from same(f"{p.post}: withheld", p.withheld, None)
            yield from same(f"{p.post}: differences", p.differences, [])
            yield from _program_told(t, p)
            yield from _feed_model(p)
        elif not p.withheld:
            yield f"{p.post}: has no files and was not withheld"
    for name in named:
        if not is_file(t, name):
            yield f"{name} is named and not there"
    if t.manifest is not None and there is not None:
        listed_programs = [[p.post, list(p.files)] for p in t.manifest.programs]
        yield from same("programs", [[p.post, list(p.files)] for p in told if p.files], listed_programs)
        for name in sorted(there - set(named)):
            yield f"{name} is a program and not named"
        said = [f"{p.files[0]}: {x}" for p in told if p.files for x in (*p.not_in_program, *p.assumed)]
        yield from same("warnings (of the manifest)", list(t.manifest.warnings), said)
        tolerance = t.manifest.program_tolerance_mm
        for p in told:
            yield from near(f"{p.post}: tolerance_mm", p.tolerance_mm, tolerance, DIGITS, 0.0)
    if t.result.exit_code != 0 and named:
        yield f"exit code {t.result.exit_code}, yet there is a robot program: {named[0]}"


def _feed_model(p: ProgramTold) -> Iterable[str]:
    """What a model says of a feed follows from the planner's moves; that it can be so is checked."""
    told = p.feed_model
    if told is None:
        return
    low, mean, held = told.lowest_percent, told.mean_percent, told.held_length_percent
    if not (0.0 <= low <= mean * (1 + DIGITS) and mean <= 100.0 * (1 + DIGITS) and 0.0 <= held <= 100.0 * (1 + DIGITS)):
        yield f"{p.post}: feed_model cannot be: {short(told)}"
    if not (told.cutting_time_s >= 0.0 and told.rounding_max_mm >= 0.0 and told.exact_stops >= 0):
        yield f"{p.post}: feed_model is below zero: {short(told)}"
    if told.rounding_max_mm > p.tolerance_mm * (1 + DIGITS):
        yield f"{p.post}: rounds by {told.rounding_max_mm:.4g} mm, more than its tolerance"


def _stint_of(t: Told, p: ProgramTold) -> Stint:
    """What of the job a program drives, by the manifest."""
    stints = stints_of(t.cell, t.toolpath)
    listed = t.manifest.programs if t.manifest is not None else ()
    number = next((one.stint for one in listed if one.files == p.files), 0)
    return stints[max(number, 1) - 1]


def _program_told(t: Told, p: ProgramTold) -> Iterable[str]:
    """What is told of one program: its checks, and what it takes for granted or leaves to a comment."""
    post = post_of(p.post, t.folder, t.cell, t.manifest)
    if post is not None:
        stint = _stint_of(t, p)
        yield from same(f"{p.post}: tool", p.tool, stint.tool if stint.number else None)
        assumed, left = to_be_told(stint.cell, stint.toolpath, post)
        yield from same(f"{p.post}: assumed", p.assumed, list(assumed))
        yield from same(f"{p.post}: not_in_program", p.not_in_program, list(left))
    found = Compared.of(Posted(p.post, post, tuple(p.files)), t.contents).as_result()
    told = p.checked
    if (found is None) != (told is None):
        yield f"{p.post}: checked is {short(told)}, {short(found)} follows"
    if found is None or told is None:
        return
    for key, value in found:
        if isinstance(value, float) and not key.startswith("moves"):
            yield from near(f"{p.post}: checked.{key}", getattr(told, key), value, AGREE, PROGRAM_ROOM)
        else:
            yield from same(f"{p.post}: checked.{key}", getattr(told, key), value)
