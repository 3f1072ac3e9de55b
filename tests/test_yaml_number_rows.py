"""Rows of numbers read without ruamel.yaml: the same values, lines and errors."""

from __future__ import annotations

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count

from machopt.errors import FileFormatError
from machopt.file_formats import strict_yaml, yaml_composition, yaml_rows
from machopt.file_formats.strict_yaml import YamlDocument, parse_yaml
from machopt.file_formats.yaml_composition import ComposedText, compose_text
from machopt.file_formats.yaml_rows import format_yaml

PIECES = (
    "[1, 2]",
    "[ -1.5e-3,.5 , +7. ]",
    "[1]",
    "[1e999]",
    "[1,\n  2, 3,\n   4]",
    "[1,\n2]",
    "[010, 99999999999999999999]",
    "[1,]",
    "[1 2]",
    "[a, 1]",
    "[]",
    "a",
    "b",
    ": ",
    ":",
    "? ",
    "- ",
    ", ",
    "\n",
    "\n  ",
    "\n    ",
    "\n- ",
    "\na: ",
    "\nb:\n  ",
    "{",
    "}",
    "[",
    "]",
    '"',
    "'",
    "|\n  ",
    " # ",
    "#",
    "&a ",
    "*a",
    "!!str ",
    "!x ",
    "---\n",
    "1",
    " ",
)


def read(text: str) -> YamlDocument | str:
    try:
        return parse_yaml(text, "file")
    except FileFormatError as error:
        return str(error)


def read_whole(text: str, monkeypatch: pytest.MonkeyPatch) -> YamlDocument | str:
    """Read every token with ruamel.yaml."""

    def compose(text: str) -> ComposedText:
        return ComposedText(yaml_composition._compose_nodes(text, yaml_composition.MAX_DEPTH))

    with monkeypatch.context() as patch:
        patch.setattr(strict_yaml, "_compose_short_text", compose)
        return read(text)


@pytest.mark.filterwarnings("ignore::ruamel.yaml.error.ReusedAnchorWarning")
@settings(max_examples=scale_example_count(400))
@given(st.lists(st.sampled_from(PIECES), max_size=14).map("".join))
@example("a: [1, 2]\nb: [[3, 4.5], [5, 6e-1]]\nc: {d: [7], e: f}")
@example("a: 'see [1, 2]'\nb: [3]")
@example("a: see [1, 2]\nb: [3]")
@example("[1, 2]: 3")
@example("a: 1\n  [2, 3]\n")
@example("a:\n  [1]\n  [2]\n")
@example("a: &a [1, 2]\nb: *a\n")
@example("a: |\n  [1, 2]\nb: [3]")
@example("a: [1, 2] # [3]\n# [4]\n")
@example("&a[1]")
@example("a: &f\n  [1, 5e400]\n")
@example("a: !!seq\n  [1, 2]\n")
@example("a: !!float [1]")
@example("[" * 99 + "[1]" + "]" * 99)
@example("[" * 100 + "[1]" + "]" * 100)
@example("a: \ue0000\ue000\nb: [1]")
@example("a: [1,\n  2]\nb: {c: [3,\n   4], d: 5}\ne:\n- [6,\n  7]\n- [8,\n\n  9]\n")
@example("a: [[1,\n  2], # [3]\n  [4]]\nb: 5e999")
@example("a: [1,\n  2e999]")
@example("a: [1,\n  2] b\nc: [3]")
@example("a: |\n  [1,\n  2]\nb: [3]")
@example("a: [1,\n  2]\n  c\n")
def test_rows_equal_those_of_the_library(text: str) -> None:
    with pytest.MonkeyPatch.context() as monkeypatch:
        whole = read_whole(text, monkeypatch)
    marked = read(text)
    if isinstance(whole, YamlDocument):
        assert isinstance(marked, YamlDocument)
        assert repr(marked.value) == repr(whole.value)  # also distinguishes 1 and 1.0
        assert marked.lines == whole.lines
    else:
        assert marked == whole


def test_matrix_is_read_without_the_library() -> None:
    text = "a:\n" + "- [1.5, -2.5e-3, 3]\n" * 50
    assert len(compose_text(text).rows) == 50
    assert parse_yaml(text, "file").value == {"a": [[1.5, -2.5e-3, 3]] * 50}


def test_too_many_values_are_refused_in_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strict_yaml, "_MAX_NODES", 50)
    with pytest.raises(FileFormatError, match="too many values"):
        parse_yaml("a: [" + ", ".join("1" * 60) + "]", "file")


NUMBERS = st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.integers(-(10**12), 10**12))
VALUES = st.recursive(
    st.one_of(
        st.lists(NUMBERS, max_size=12), NUMBERS, st.booleans(), st.none(), st.text("aé [1,]\ue0000\"'-", max_size=8)
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text("abc", min_size=1), inner, max_size=4)
    ),
    max_leaves=12,
)


@settings(max_examples=scale_example_count(100))
@given(st.dictionaries(st.text("abc", min_size=1), VALUES, max_size=4))
@example({"a": [[1.5, 2, -3e-7], [4.0, 5]], "b": [], "c": [True, 1.0], "d": {"e": [1e300], "f": 2}})
@example({"a": "\ue0000\ue000", "b": [1.0]})
@example({"a": [0.1 + 1e-9 * n for n in range(40)]})
@example(
    {"a": {"b": [[0.1 + 1e-9 * n for n in range(k, 40)] for k in (0, 1)], "c": [1.0], "d": [[[1.0 / 3.0] * 20], 1]}}
)
@example({"a" * 201: [1.0, 2.0], "b": [[10**16, 1.0], "x"]})
def test_rows_are_written_as_by_the_library(data: dict[str, object]) -> None:
    plain = yaml_rows._dump(data, [])
    assert format_yaml(data) == plain
    assert parse_yaml(plain, "file").value == data
