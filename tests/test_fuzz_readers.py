"""Mutated and truncated files of every dialect: refused or valid, no crash and no hang.

A small sample runs here; ``python benchmarks/fuzz_readers.py`` runs 100,000 cases a format.
"""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from program_mutations import HANG, check, limit_time
from toolpath_file_samples import SAMPLES, Sample

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

CASES = 120  # per dialect
NUMBERS = ("1e308", "-1e308", "nan", "inf", "99999999999", "0", "-0.", ".", "1e-300", "--3", "1.2.3", "1_0", "\u0663")
WORDS = (
    "G2",
    "G3",
    "G1",
    "G0",
    "G68.2",
    "G53.1",
    "G69",
    "G91",
    "G93",
    "G81",
    "G18",
    "G43.4",
    "M98 P100",
    "M99",
    "M30",
    "GOTO 10",
    "WHILE[1 EQ 1]DO1",
    "END1",
    "IF R1<1E9 GOTOB START",
    "R1=1/0",
    "#1=#1",
    "o1 while [1]",
    "o1 endwhile",
    "LBL 1",
    "CALL LBL 1",
    "CALL LBL 1 REP 99999",
    "CYCL CALL",
    "PLANE SPATIAL SPA+90 SPB+90 SPC+90",
    "CC X+0 Y+0",
    "C DR+",
    "CP IPA+99999 DR+",
    "CYCLE/OFF",
    "CIRCLE/0,0,0,0,0,1",
    "RAPID",
    "SET/MODE,INCR",
    "UNITS/INCHES",
    "MSYS/0",
    "NURBS/",
    "FINI",
    "END",
    "MULTAX",
    "1003",
    "11",
    "A90",
    "B45",
    "C1e9",
    "F0",
    "F-1",
    "S0",
    "TRAORI",
    "CYCLE800()",
    "X=IC(5)",
    "FOR R9=1 TO 1E9",
    "ENDFOR",
    "REPEAT",
    "UNTIL 0",
    "TIMES,1e9",
    "Q201=-1e9",
    "Q202=1e-9",
    "L99999",
    "$",
    "~",
    "(",
    ")",
    "/",
    "%",
    "\x00",
    "\ufeff",
)


def mutate_text(rng: np.random.Generator, text: str) -> str:
    """Return the text with one to four faults."""
    for _ in range(int(rng.integers(1, 5))):
        lines = text.split("\n")
        at = int(rng.integers(len(lines)))
        match int(rng.integers(10)):
            case 0:  # truncated
                text = text[: int(rng.integers(len(text) + 1))]
            case 1:
                lines.pop(at)
                text = "\n".join(lines)
            case 2:
                lines.insert(at, lines[int(rng.integers(len(lines)))])
                text = "\n".join(lines)
            case 3:
                k = int(rng.integers(len(lines)))
                lines[at], lines[k] = lines[k], lines[at]
                text = "\n".join(lines)
            case 4 | 5:
                lines.insert(at, str(rng.choice(WORDS)))
                text = "\n".join(lines)
            case 6:
                lines[at] += " " + str(rng.choice(WORDS))
                text = "\n".join(lines)
            case 7:  # another number
                digits = [k for k, c in enumerate(text) if c.isdigit()]
                if digits:
                    k = digits[int(rng.integers(len(digits)))]
                    text = text[:k] + str(rng.choice(NUMBERS)) + text[k + 1 :]
            case 8:  # another character
                if text:
                    k = int(rng.integers(len(text)))
                    text = text[:k] + chr(int(rng.integers(9, 300))) + text[k + 1 :]
            case 9:
                a, b = sorted(int(v) for v in rng.integers(len(text) + 1, size=2))
                text = text[:a] + text[min(b, a + 40) :]
        if not text:
            return "\n"
    return text


def read(file: Path, sample: Sample, rng: np.random.Generator) -> Toolpath | None:
    """Return the toolpath, or None if the file is refused; any other result is a failure."""
    options: dict[str, object] = {**sample.options, "default_feed": 0.01}
    if rng.random() < 0.5:
        options.setdefault("unit", "mm")
    if rng.random() < 0.3:
        options.setdefault("machine", "table-ac@0,0,-50")
    try:
        return read_toolpath(file, strict=bool(rng.random() < 0.1), **options)  # type: ignore[arg-type]
    except InputError as error:
        if not error.reason.strip():
            raise
        return None


def run(sample: Sample, cases: int, seed: int, folder: Path) -> Counter[str]:
    """Read the given number of mutated files of one dialect.

    Raises:
        AssertionError: a case that crashes, hangs or gives a meaningless result; the file is left in ``folder``.
    """
    rng = np.random.default_rng(seed)
    file = folder / sample.name
    count: Counter[str] = Counter()
    for case in range(cases):
        text = mutate_text(rng, sample.text)
        file.write_bytes(text.replace("\n", "\r\n").encode() if rng.random() < 0.1 else text.encode())
        start = time.process_time()
        try:
            with limit_time(HANG):
                toolpath = read(file, sample, rng)
                if toolpath is not None:
                    check(toolpath, text.count("\n") + text.count("\r") + 2)
        except Exception as error:
            error.add_note(f"{sample.name}, case {case} of seed {seed}:\n{text}")
            raise
        count["read" if toolpath is not None else "refused"] += 1
        count["slowest_ms"] = max(count["slowest_ms"], round(1e3 * (time.process_time() - start)))
    return count


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda s: s.name)
def test_mutated_files_are_refused_or_read_validly(sample: Sample, tmp_path: Path) -> None:
    count = run(sample, CASES, 1, tmp_path)
    assert count["refused"] > 0
    assert count["read"] > 0


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda s: s.name)
def test_every_sample_is_read_without_unknown_words(sample: Sample, tmp_path: Path) -> None:
    file = tmp_path / sample.name
    file.write_text(sample.text, encoding="utf-8")
    t = read_toolpath(file, strict=True, **sample.options)  # type: ignore[arg-type]
    check(t, sample.text.count("\n") + 1)
    assert "incomplete" not in t.meta


FOUND = (  # cases from a long run: the sample, what is replaced in it, and the message now
    ("nx.cls", "KNOT/0.5,1.0", "KNOT/0.1e-300,1.0", "(inf|nan) chords in one span of a spline"),
    ("part.nci", "1\n40 -10. 5. -1. -1. 0\n11\n", "3\n1\n11\n", "an arc of 1 numbers; expected 8"),
)


@pytest.mark.parametrize(("name", "old", "new", "message"), FOUND)
def test_earlier_fuzz_failures_are_refused(name: str, old: str, new: str, message: str, tmp_path: Path) -> None:
    sample = next(s for s in SAMPLES if s.name == name)
    assert old in sample.text
    (tmp_path / name).write_text(sample.text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_toolpath(tmp_path / name, default_feed=0.01, **sample.options)  # type: ignore[arg-type]


@pytest.mark.parametrize("sample", [s for s in SAMPLES if s.end], ids=lambda s: s.name)
def test_truncated_file_is_refused_or_reported_as_incomplete(sample: Sample, tmp_path: Path) -> None:
    """The file is cut after every line: if it is read, the first warning states that a part may be missing."""
    file = tmp_path / sample.name
    lines = sample.text.split("\n")
    count = 0
    for k in range(3, lines.index(sample.end)):
        file.write_text("\n".join(lines[:k]) + "\n", encoding="utf-8")
        try:
            t = read_toolpath(file, default_feed=0.01, **{"unit": "mm", **sample.options})  # type: ignore[arg-type]
        except InputError:
            continue
        count += 1
        assert t.warnings[0].startswith("INCOMPLETE FILE?"), (k, t.warnings)
        assert t.meta["incomplete"]
    assert count > 0
