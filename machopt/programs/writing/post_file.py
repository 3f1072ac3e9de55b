"""Reader of a post: the TOML file that defines the text of a program. README.md explains it to users."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

from pydantic import Field

from machopt.data_types.robot_program import EVENT_LINES
from machopt.errors import InputError, PostError, suggest_nearest_word
from machopt.file_formats.file_reading import TEMPLATE, read_text
from machopt.file_formats.strict_yaml import StrictSchema, YamlDocument, validate_document
from machopt.programs.maker_registry import list_templates
from machopt.programs.writing.template_language import TextTemplate, compile_template

ALIASES = {"ros": "ros_yaml"}
ITEMS = (
    "call",
    "note",
    "part",
    "speed",
    "zone",
    "corner",
    "via",
    "operation",
    "move",
    "ptp_change",
    "lin_change",
    "ptp",
    "lin",
    "run_begin",
    "run",
    "run_end",
    *EVENT_LINES,
)


class PostFileKeys(StrictSchema):
    name: str = Field(min_length=1, description="the file's name, a template")
    each: Literal["program", "part"] = Field(default="program", description="one for the program, or one for each part")
    text: str = Field(
        description="the file's text, a template; a line that is only @{block} is replaced by the lines of the block"
    )


class ProgramNameKeys(StrictSchema):
    pattern: str = Field(description="what the controller takes as a name, as a regular expression")
    length: int = Field(gt=3, description="longest name")
    upper: bool = False
    reserved: list[str] = Field(default=[], description="words the controller's language keeps, whatever the case")


class NumberFormatKeys(StrictSchema):
    after: str = Field(description="the line after which line numbers begin")
    before: str = Field(description="the line before which they end")
    format: str = Field(pattern=r"^%[0-9]*d[^%]*$", description="like %4d:")
    most: int | None = Field(default=None, gt=0, description="highest line number of the controller")


class PostKeys(StrictSchema):
    machopt_post: Literal[1]
    dialect: str
    title: str = Field(min_length=1)
    encoding: Literal["ascii", "utf-8"] = "ascii"
    line_end: Literal["lf", "crlf"] = "lf"
    escape: Literal["plain", "json", "csv", "xml"] = Field(default="plain", description="how free text is made safe")
    forbid: str = Field(default="", description="characters that free text must not hold; they become spaces")
    comment_length: int = Field(default=120, ge=8)
    moves_per_part: int | None = Field(default=None, gt=0)
    samples: bool = Field(default=False, description="takes the control samples with their times, not the way points")
    name: ProgramNameKeys
    part_text: str = Field(default="", description="text for each part where a program has several")
    number: NumberFormatKeys | None = None
    file: list[PostFileKeys] = Field(min_length=1)
    block: dict[str, dict[str, str]] = Field(description="tables of line templates, one table a block")


@dataclass(frozen=True)
class ProgramFileTemplate:
    name: TextTemplate
    each: str
    text: tuple[TextTemplate | str, ...]  # a str is the name of a block


@dataclass(frozen=True, kw_only=True)
class PostTemplate:
    """A compiled post."""

    keys: PostKeys
    files: tuple[ProgramFileTemplate, ...]
    part_text: tuple[TextTemplate | str, ...]
    blocks: Mapping[str, Mapping[str, TextTemplate]]
    separators: Mapping[str, str]
    whole: frozenset[str]  # blocks that hold every move of the program, at any place
    origin: Path | str

    def list_texts(self) -> list[TextTemplate]:
        """The templates of the files' names and lines, outside the blocks."""
        texts = [t for f in self.files for t in (f.name, *f.text)] + list(self.part_text)
        return [t for t in texts if isinstance(t, TextTemplate)]

    @property
    def list_used_fields(self) -> frozenset[str]:
        """Every field it uses anywhere."""
        items = [t for b in self.blocks.values() for t in b.values()]
        return frozenset(name for t in [*self.list_texts(), *items] for name in t.names)


def list_post_names() -> tuple[str, ...]:
    """The posts that come with machopt."""
    return tuple(list_templates())


def read_post_text(name: str) -> str:
    """Return the template text of a shipped post, to be copied and edited.

    Args:
        name: Name of the post.

    Returns:
        Text of the template file.

    Raises:
        PostError: there is no such post.
    """
    name = ALIASES.get(name, name)
    if name not in list_post_names():
        raise PostError(
            f"no post is named {name!r}; {suggest_nearest_word(name, [*list_post_names(), *ALIASES])}", where="post"
        )
    return list_templates()[name].read_text(encoding="utf-8")


def load_post(post: str | Path) -> PostTemplate:
    """Load a post by its name or from a template file.

    Args:
        post: Name of a shipped post, or a file: a Path or a text that ends in .toml.

    Returns:
        The parsed template.

    Raises:
        PostError: no such post or file, not TOML, an unknown key, item or field.
    """
    if isinstance(post, str) and not post.endswith(".toml"):
        return _compile_post(read_post_text(post), f"post {post}")
    path = Path(post)
    expected = f"a post template, or a name: {', '.join(list_post_names())}"
    return _compile_post(read_text(path, expected=expected, most=TEMPLATE), path)


@lru_cache(maxsize=32)  # one plan loads the same post about twenty times; a post is never modified
def _compile_post(text: str, origin: Path | str) -> PostTemplate:
    try:
        value = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise PostError(f"is not TOML: {problem}", file=origin) from None
    keys = validate_document(PostKeys, YamlDocument(value, {}, origin))
    try:
        re.compile(keys.name.pattern)
        blocks: dict[str, dict[str, TextTemplate]] = {}
        separators: dict[str, str] = {}
        whole = frozenset(name for name, table in keys.block.items() if table.get("of") == "program")
        for block, table in keys.block.items():
            separators[block] = table.get("separator", "")
            blocks[block] = {}
            for item, line in table.items():
                if item in ("separator", "of"):
                    if item == "of" and line not in ("part", "program"):
                        raise PostError(f"found {line!r}; expected part or program", where=f"block.{block}.of")
                    continue
                if item not in ITEMS:
                    valid = [*ITEMS, "separator", "of"]
                    raise PostError(
                        f"unknown key {item!r}; {suggest_nearest_word(item, valid)}", where=f"block.{block}"
                    )
                blocks[block][item] = compile_template(line.removesuffix("\n"), f"block.{block}.{item}")
        known = {*blocks, "body", "parts"}
        files = tuple(
            ProgramFileTemplate(
                compile_template(f.name, f"file[{n}].name"), f.each, _compile_lines(f.text, known, f"file[{n}].text")
            )
            for n, f in enumerate(keys.file)
        )
        part_text = _compile_lines(keys.part_text, known, "part_text")
    except InputError as problem:
        raise PostError(problem.reason, file=origin, where=problem.where) from None
    except re.error as problem:
        raise PostError(f"is no regular expression: {problem}", file=origin, where="name.pattern") from None
    return PostTemplate(
        keys=keys, files=files, part_text=part_text, blocks=blocks, separators=separators, whole=whole, origin=origin
    )


def _compile_lines(text: str, blocks: set[str], where: str) -> tuple[TextTemplate | str, ...]:
    """A text as templates of single lines, and names of the blocks that stand on lines of their own."""
    out: list[TextTemplate | str] = []
    for line in text.removesuffix("\n").split("\n") if text else []:
        name = line.strip()[2:-1] if line.strip().startswith("@{") and line.strip().endswith("}") else ""
        out.append(name if name in blocks else compile_template(line, where))
    return tuple(out)
