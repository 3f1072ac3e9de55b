"""Keys of a job list, and conversion of its reading options to SI units."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from machopt.file_formats.source_file import parse_offsets as work_offsets
from machopt.file_formats.strict_yaml import StrictSchema
from machopt.options.option_schema import OptionKeys


class ReadingOptionKeys(StrictSchema):
    """What a toolpath file may not say itself."""

    unit: Literal["mm", "inch"] | None = Field(default=None, description="of a file that does not state it")
    machine: str | None = Field(default=None, min_length=1, description="kinematics behind rotary axes, e.g. table-ac")
    feed_mm_min: float | None = Field(default=None, gt=0, description="feed of cutting moves in a file that has none")
    strict: bool | None = Field(default=None, description="true: words that are not understood are refused")
    tool_axis: Literal["-z", "+z", "-x", "+x", "-y", "+y"] | None = Field(
        default=None, description="direction from tip to shank in the tool frame of robot programs, e.g. -z"
    )
    offsets: list[str] | None = Field(
        default=None, min_length=1, description="work offsets in the first one, mm, e.g. [G55=100,0,0]"
    )
    cycle_order: list[Literal["depth", "clear", "retract"]] | None = Field(
        default=None, min_length=3, max_length=3, description="meaning of the unnamed numbers of CYCLE/"
    )
    decimals: int | None = Field(default=None, ge=0, le=6, description="places of G-code numbers without a point")
    accept_unknown: list[str] | None = Field(
        default=None, min_length=1, description="words that are not understood and move nothing, e.g. [PPRINTX]"
    )
    kind: Literal["path", "holes"] | None = Field(
        default=None, description="meaning of the rows of a point table that does not state it"
    )
    max_extent_mm: float | None = Field(default=None, gt=0, description="longest path that is believed")


class CommonJobKeys(StrictSchema):
    """Keys of one job, or of all jobs of a list."""

    time_limit_s: float | None = Field(default=None, gt=0, description="seconds a job may take")
    memory_limit_MiB: float | None = Field(default=None, gt=0, description="memory a job may use")
    post: str | None = Field(default=None, min_length=1, description="robot program to write: a post's name or file")
    posts: list[str] | None = Field(default=None, min_length=1, description="the same, several of them")


class BatchJobKeys(CommonJobKeys):
    cell: str | None = Field(default=None, min_length=1, description="cell folder or its cell.yaml")
    toolpath: str = Field(min_length=1, description="a CAM file or point table, or a pattern such as *.nc")
    name: str | None = Field(default=None, min_length=1, description="a name for the job's folder and the summary")
    options: OptionKeys | None = Field(default=None, description="planning options of this job")
    reading: ReadingOptionKeys | None = Field(default=None, description="how its toolpath is read")


class JobListKeys(CommonJobKeys):
    machopt_batch: Literal[1] = Field(description="the format, 1")
    cells: list[str] = Field(default=[], description="cell folders, or their cell.yaml")
    toolpaths: list[str] = Field(default=[], description="CAM files, point tables or patterns such as parts/*.nc")
    options: dict[str, OptionKeys] = Field(default={}, description="planning options by the name of the variant")
    reading: ReadingOptionKeys | None = Field(default=None, description="how toolpaths are read")
    jobs: list[BatchJobKeys] = Field(default=[], description="further jobs, in addition to cells × toolpaths × options")


def convert_reading_to_si(keys: ReadingOptionKeys | None) -> dict[str, object]:
    """Convert reading options to keywords of :func:`machopt.toolpath.toolpath_reader.read_toolpath`.

    Args:
        keys: Validated reading options, None for none.

    Returns:
        The given keywords; the feed in m/s.
    """
    given = {} if keys is None else keys.model_dump(exclude_none=True)
    if "feed_mm_min" in given:
        given["default_feed"] = given.pop("feed_mm_min") / 60e3
    work_offsets(given.get("offsets", ()))  # refused here, with the list's other faults
    if "max_extent_mm" in given:
        given["max_extent"] = given.pop("max_extent_mm") * 1e-3
    return given
