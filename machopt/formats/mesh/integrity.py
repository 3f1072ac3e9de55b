"""Is a mesh file whole? Told from its own counts, before a library reads it.

The libraries behind planner and verifier differ in what they make of a cut file: fewer triangles, none, or a crash.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from pathlib import Path

from machopt.errors import InputError
from machopt.formats.opener import MESH, read_file

Fail = Callable[[str], InputError]

READABLE = (".stl", ".obj", ".ply", ".off")
_MOST_TRIANGLES = 2_000_000  # distances to more take gigabytes and minutes; a collision mesh has some thousand
_STL_HEAD, _STL_FACET = 84, 50  # bytes
_BLANK = re.compile(rb"[ \t\r\n]+")


def whole_mesh(path: Path, fail: Fail) -> bytes:
    """The bytes of a mesh file that is as long as it says.

    Args:
        path: the file.
        fail: makes the error that names where the mesh is used.

    Raises:
        InputError: unknown suffix, no readable file, too large, cut, or damaged in its head.
    """
    suffix = path.suffix.lower()
    if suffix not in READABLE:
        raise fail(f"mesh {path.name} is of type {path.suffix or 'none'!r}; readable: {', '.join(READABLE)}")
    try:
        data = read_file(path, expected="a mesh", most=MESH)
    except InputError as problem:
        hint = "; a decimated mesh, or its convex parts, would work" if "MiB" in problem.reason else ""
        raise fail(f"mesh {path.name} {problem.reason}{hint}") from None
    if not data:
        raise fail(f"mesh {path.name} is empty")
    if suffix == ".stl":
        _check_stl(path.name, data, fail)
    elif suffix in (".ply", ".off"):
        vertices, faces = (_ply_counts if suffix == ".ply" else _off_counts)(path.name, data, fail)
        _refuse_too_many(path.name, faces, fail)
        if vertices < 1 or faces < 1:
            raise fail(f"mesh {path.name} holds no triangles: its head counts {vertices} vertices and {faces} faces")
    elif b"\0" in data[:4096]:
        raise fail(f"mesh {path.name} cannot be read: it is binary, and OBJ is text")
    return data


def declared_counts(path: Path, data: bytes, fail: Fail) -> tuple[int, int] | None:
    """(vertices, faces) that the head promises; None where the format counts nothing."""
    suffix = path.suffix.lower()
    if suffix == ".ply":
        return _ply_counts(path.name, data, fail)
    return _off_counts(path.name, data, fail) if suffix == ".off" else None


def _check_stl(name: str, data: bytes, fail: Fail) -> None:
    if len(data) >= _STL_HEAD:
        count = struct.unpack_from("<I", data, 80)[0]
        if len(data) == _STL_HEAD + _STL_FACET * count:
            _refuse_too_many(name, count, fail)
            if not count:
                raise fail(f"mesh {name} holds no triangles")
            return
    if data[:512].lstrip()[:5].lower() == b"solid" and b"\0" not in data[:512]:
        _check_ascii_stl(name, data, fail)
        return
    if len(data) < _STL_HEAD:
        raise fail(f"mesh {name} cannot be read: {len(data)} bytes are too few for binary STL, and it is no ASCII STL")
    need = _STL_HEAD + _STL_FACET * count
    what = "is cut" if len(data) < need else "is damaged"
    raise fail(f"mesh {name} {what}: its head counts {count} triangles, which take {need} bytes, and it holds "
               f"{len(data)}; a fresh export would work")  # fmt: skip


def _check_ascii_stl(name: str, data: bytes, fail: Fail) -> None:
    words = data.lower()
    begun, ended = (len(re.findall(pattern, words, re.MULTILINE)) for pattern in (rb"^\s*facet\s", rb"^\s*endfacet\b"))
    corners = len(re.findall(rb"^\s*vertex\s", words, re.MULTILINE))
    if begun != ended or corners != 3 * begun or not re.search(rb"^\s*endsolid\b", words, re.MULTILINE):
        raise fail(f"mesh {name} is cut or damaged: {begun} facets begin, {ended} end, with {corners} corners of "
                   f"{3 * begun}, line {data.count(10) + 1} is the last; a fresh export would work")  # fmt: skip
    if not begun:
        raise fail(f"mesh {name} holds no triangles")
    _refuse_too_many(name, begun, fail)


def _ply_counts(name: str, data: bytes, fail: Fail) -> tuple[int, int]:
    head, mark, _ = data[:65536].partition(b"end_header")
    if not head.startswith(b"ply") or not mark:
        raise fail(f"mesh {name} cannot be read: it does not begin with a PLY header")
    found = {what: int(n) for what, n in re.findall(rb"^element\s+(vertex|face)\s+(\d{1,12})\s*$", head, re.MULTILINE)}
    if set(found) != {b"vertex", b"face"}:
        raise fail(f"mesh {name} cannot be read: its header does not count both vertices and faces")
    if found[b"vertex"] * 3 + found[b"face"] > len(data):  # a coordinate takes a byte and more
        raise fail(f"mesh {name} is cut: its header counts {found[b'vertex']} vertices and {found[b'face']} faces, and "
                   f"it holds {len(data)} bytes")  # fmt: skip
    return found[b"vertex"], found[b"face"]


def _off_counts(name: str, data: bytes, fail: Fail) -> tuple[int, int]:
    lines = [line.split(b"#")[0] for line in data[:65536].splitlines()]
    words = _BLANK.split(b" ".join(lines).strip(), maxsplit=4)
    if len(words) < 4 or words[0] != b"OFF" or not all(re.fullmatch(rb"\d{1,12}", w) for w in words[1:3]):
        raise fail(f"mesh {name} cannot be read: it does not begin with OFF and the counts of vertices and faces")
    return int(words[1]), int(words[2])


def _refuse_too_many(name: str, count: int, fail: Fail) -> None:
    if count > _MOST_TRIANGLES:
        raise fail(f"mesh {name} holds {count} triangles; expected at most {_MOST_TRIANGLES}: a decimated mesh, or its "
                   "convex parts, would work")  # fmt: skip
