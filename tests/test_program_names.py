"""Program names from file names in any script: valid on every controller, and unique."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from sample_robot_programs import MAPPED, Recipe, program

from machopt.programs.program_writer import format_program_name, list_post_names, write_program

FILES = (
    "Наладка",
    "Обработка",
    "деталь 2",
    "деталь-2",
    "部品加工",
    "穴あけ",
    "夹具",
    "夹剧",
    "드릴",
    "Größe",
    "Grösse",
    "Pièce usinée",
    "Çapak alma",
    "Φρέζα",
    "مثقاب",
    "חור",
    "เจาะ",
    "छेद",
    "🙂",
    "№ 5",
    "２０",
    "Наладка_с_очень_длинным_именем_детали_1",
    "Наладка_с_очень_длинным_именем_детали_2",
)


@pytest.mark.parametrize("post", list_post_names())
def test_names_are_valid_and_unique_in_every_post(post: str) -> None:
    names = [format_program_name(f"{text}.csv", post) for text in FILES]
    assert len({n.lower() for n in names}) == len(FILES)
    for name in names:
        assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name), name
        assert name == format_program_name(f"{FILES[names.index(name)]}.csv", post)


def test_name_is_recognisable() -> None:
    assert format_program_name("Наладка", "krl").lower().startswith("naladka")
    assert format_program_name("Größe", "krl").lower().startswith("grosse")


@pytest.mark.parametrize("post", list_post_names())
def test_programs_are_written_with_such_names(tmp_path: Path, post: str) -> None:
    for text in ("Наладка", "部品加工"):
        name = format_program_name(text, post)
        files = write_program(tmp_path / text, name, program(Recipe(1, moves=6), MAPPED), post, MAPPED)
        assert files
