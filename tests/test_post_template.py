"""User-defined posts: template language, checks, and safety."""

from __future__ import annotations

from pathlib import Path

import pytest
from sample_robot_programs import PLAIN, Recipe, program

from machopt.errors import InputError
from machopt.programs.program_reader import read_program
from machopt.programs.program_writer import list_post_names, read_post_text, write_program
from machopt.programs.writing.post_file import load_post
from machopt.programs.writing.template_language import compile_template

NAN = float("nan")


@pytest.mark.parametrize(
    ("text", "values", "expected"),
    [
        ("a @{x:.2f} b", {"x": 1.005001}, "a 1.01 b"),
        ("@{x:.3f}", {"x": -1e-9}, "0.000"),  # no negative zero
        ("@{n:4d}:@{n:03d}", {"n": 7}, "   7:007"),
        ("{X @{x:g}} $TOOL=100% @ @@", {"x": 2.0}, "{X 2} $TOOL=100% @ @@"),
        ("L@[c| C_DIS@]", {"c": True}, "L C_DIS"),
        ("L@[c| C_DIS@]@[!c| FINE@]", {"c": False}, "L FINE"),
        ("@[s|,S @{s:d}@],T @{t:d}", {"s": NAN, "t": 3}, ",T 3"),
        ("@{x}", {"x": "__import__('os')"}, "__import__('os')"),
    ],
)
def test_template_language(text: str, values: dict[str, object], expected: str) -> None:
    template = compile_template(text, "here")
    assert template.one(values) == expected
    columns = {name: [value, value] for name, value in values.items()}
    assert template.rows(columns, [0, 1]) == [expected] * 2


@pytest.mark.parametrize(
    "text",
    [
        "@{x.__class__}",
        "@{x[0]}",
        "@{x!r}",
        "@{x:>10}",
        "@{x:.9999f}",
        "@{}",
        "@{X}",
        "@[a|b",
        "a@]",
        "@[a|@[b|c@]@]",
        "@{x:{y}}",
        "@{x",
    ],
)
def test_text_outside_the_template_language_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="here"):
        compile_template(text, "here")


def test_field_without_a_value_is_reported() -> None:
    with pytest.raises(InputError, match=r"no value for @\{x\}; put it into a section"):
        compile_template("@{x:.1f}", "here").one({"x": NAN})


@pytest.mark.parametrize("post", list_post_names())
def test_copied_post_writes_the_same(tmp_path: Path, post: str) -> None:
    copy = tmp_path / "mine.toml"
    copy.write_text(read_post_text(post), encoding="utf-8")
    name = "PART" if post.startswith(("fanuc", "jbi")) else "part"
    p = program(Recipe(1))
    for folder, given in ((tmp_path / "a", post), (tmp_path / "b", str(copy)), (tmp_path / "c", copy)):
        folder.mkdir()
        write_program(folder, name, p, given, PLAIN)
    files = sorted(f.relative_to(tmp_path / "a") for f in (tmp_path / "a").rglob("*") if f.is_file())
    for file in files:
        assert (
            (tmp_path / "a" / file).read_bytes()
            == (tmp_path / "b" / file).read_bytes()
            == (tmp_path / "c" / file).read_bytes()
        )


def test_edited_post_is_used(tmp_path: Path) -> None:
    text = read_post_text("krl").replace('call = "', 'spindle_on = "SPINDLE(@{value:.0f})  ; CAM: @{text}"\ncall = "')
    text = text.replace("$ADVANCE=3", "$ADVANCE=5\n$ACC.CP=2.3").replace("moves_per_part = 4000", "moves_per_part = 5")
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    p = program(Recipe(1, events=0))
    from dataclasses import replace

    from machopt.data_types.toolpath import ToolpathEvent

    p = replace(p, events=(ToolpathEvent(2, "spindle", "S9000 M3", 9000.0),))
    src, _ = write_program(tmp_path, "part", p, tmp_path / "mine.toml", PLAIN)
    lines = src.read_text().splitlines()
    assert "$ACC.CP=2.3" in lines
    assert "SPINDLE(9000)  ; CAM: S9000 M3" in lines
    assert sum(line.startswith("DEF ") for line in lines) == 4  # main and 12 moves in groups of five
    parsed = read_program(src)
    assert len(parsed) == len(p)
    assert [(e.index, e.text) for e in parsed.events] == [(2, "S9000 M3")]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("machopt_post = 1", "machopt_post = 2", "machopt_post"),
        ('dialect = "krl"', 'dialect = "kuka"', "no dialect is named 'kuka'"),
        ("comment_length", "coment_length", "unknown key 'coment_length'; did you mean 'comment_length'"),
        ('operation = "', 'opration = "', "unknown key 'opration'"),
        ("@{a1:.5f}", "@{axis1:.5f}", "no field is named 'axis1'"),
        # not available in the head
        ("BAS(#VEL_PTP,@{ptp_percent:g})", "BAS(#VEL_PTP,@{a1:g})", "no field is named 'a1'"),
        ("BAS(#VEL_PTP,@{ptp_percent:g})", "BAS(#VEL_PTP,@{ptp_percent:x})", "formats d, f, g, s"),
        ('pattern = "', 'pattern = "(', "no regular expression"),
        ("[[file]]", "[[file", "is not TOML"),
        ('name = "@{name}.src"', 'name = "../@{name}.src"', "no file inside the output folder"),
        ('name = "@{name}.src"', 'name = "/tmp/@{name}.src"', "no file inside the output folder"),
    ],
)
def test_mistakes_in_a_post_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = read_post_text("krl")
    assert old in text
    file = tmp_path / "mine.toml"
    file.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        write_program(tmp_path, "part", program(Recipe(1)), file, PLAIN)
    assert message in str(caught.value)
    assert not list(tmp_path.glob("*.src"))


def test_unknown_posts_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no post is named 'kuka'"):
        load_post("kuka")
    with pytest.raises(InputError, match="no such file; expected a post template, or a name: compas_fab, csv"):
        load_post(tmp_path / "none.toml")


def test_text_from_the_cam_file_cannot_become_code(tmp_path: Path) -> None:
    """Every post removes or escapes line ends, comment ends and quotes of a label."""
    from dataclasses import replace

    from machopt.data_types.toolpath import ToolpathEvent

    evil = 'a"; $OUT[1]=TRUE \n$OUT[2]=TRUE ]]> } ; *) \\ \x00 ü\t"'
    p = program(Recipe(1, operations=(evil,), events=0))
    p = replace(p, events=(ToolpathEvent(3, "comment", evil),), source=evil)
    for post in list_post_names():
        folder = tmp_path / post
        folder.mkdir()
        name = "PART" if post.startswith(("fanuc", "jbi")) else "part"
        files = write_program(folder, name, p, post, PLAIN)
        plain = tmp_path / f"{post}_plain"
        plain.mkdir()
        same = write_program(
            plain,
            name,
            replace(p, operations=("a",), events=(ToolpathEvent(3, "comment", "b"),), source="c"),
            post,
            PLAIN,
        )
        for file, other in zip(files, same, strict=True):
            text = file.read_text(encoding="utf-8")
            outside = [
                t
                for t in text.splitlines()
                if "OUT[2]" in t
                and not t.strip().startswith((";", "!", "#", "//", "'", '"', "{", "lin", "ptp", "event"))
            ]
            assert not [t for t in outside if not t.lstrip("0123456789: ").startswith("!")], (post, outside)
            if post not in ("fanuc", "fanuc_joint", "jbi", "jbi_rectan"):  # these posts wrap the comments of the head
                assert len(text.splitlines()) == len(other.read_text(encoding="utf-8").splitlines())
        main = next(
            f for f in files if f.suffix in (".src", ".mod", ".ls", ".script", ".pjx", ".JBI", ".csv", ".json", ".yaml")
        )
        assert len(read_program(main)) == len(p)
