"""Integrity check of a mesh file from its own counts, before a library reads it.

The libraries of planner and verifier treat a truncated file differently: fewer triangles, none, or a crash.
"""

from __future__ import annotations

import os
import re
import struct
from pathlib import Path

from machopt.cell.mesh.mesh_errors import ErrorFactory
from machopt.cell.mesh.ply_off_checks import check_off, check_ply
from machopt.errors import InputError
from machopt.file_formats.file_reading import MESH, read_file

READABLE = (".stl", ".obj", ".ply", ".off")
_MOST_TRIANGLES = 2_000_000  # distances to more take gigabytes and minutes; a collision mesh has some thousand
_STL_HEAD, _STL_FACET = 84, 50  # bytes
_N = rb"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_STL_LINE = re.compile(  # lower case; the normals are not used, and exporters write nan there
    rb"\s*(?:facet\s+normal\s+\S+\s+\S+\s+\S+|vertex\s+%b\s+%b\s+%b|outer\s+loop|endloop|endfacet|"
    rb"(?:end)?solid\b.*)?\s*" % (_N, _N, _N)
)
_OBJ_LINE = re.compile(
    rb"\s*(?:v\s+%b\s+%b\s+%b(?:\s+%b)*|f(?:\s+-?[0-9]+(?:/-?[0-9]*){0,2}){3,}|v[tnp]\s.*|[^vf\s].*)?\s*"
    % (_N, _N, _N, _N)
)

_LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]*)", re.MULTILINE)
_FREE_FORM = re.compile(rb"^[ \t]*(cstype|surf|curv2?|bmat|parm)\b", re.MULTILINE)


def read_whole_mesh(path: Path, fail: ErrorFactory) -> bytes:
    """Read a mesh file whose length matches its counts.

    Args:
        path: the file.
        fail: makes the error that names where the mesh is used.

    Raises:
        InputError: unknown suffix, no readable file, too large, cut, or damaged in its head.
    """
    suffix = path.suffix.lower()
    if suffix not in READABLE:
        raise fail(f"mesh {path.name} is of type {path.suffix or 'none'!r}; readable: {', '.join(READABLE)}, .dae")
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
        counts = (check_ply if suffix == ".ply" else check_off)(path.name, data, fail)
        _refuse_too_many(path.name, counts.faces, fail)
        if counts.vertices < 1 or counts.faces < 1:
            raise fail(
                f"mesh {path.name} holds no triangles: its head counts {counts.vertices} vertices and "
                f"{counts.faces} faces"
            )
    else:
        _check_obj(path.name, data, fail)
        _check_libraries(path, data, fail)
    return data


def _check_stl(name: str, data: bytes, fail: ErrorFactory) -> None:
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
    raise fail(
        f"mesh {name} {what}: its head counts {count} triangles, which take {need} bytes, and it holds "
        f"{len(data)}; a fresh export would work"
    )


def _check_ascii_stl(name: str, data: bytes, fail: ErrorFactory) -> None:
    words = data.lower()
    begun, ended = (len(re.findall(pattern, words, re.MULTILINE)) for pattern in (rb"^\s*facet\s", rb"^\s*endfacet\b"))
    corners = len(re.findall(rb"^\s*vertex\s", words, re.MULTILINE))
    if begun != ended or corners != 3 * begun or not re.search(rb"^\s*endsolid\b", words, re.MULTILINE):
        raise fail(
            f"mesh {name} is cut or damaged: {begun} facets begin, {ended} end, with {corners} corners of "
            f"{3 * begun}, line {data.count(10) + 1} is the last; a fresh export would work"
        )
    if not begun:
        raise fail(f"mesh {name} holds no triangles")
    _refuse_too_many(name, begun, fail)
    _check_lines(name, words, _STL_LINE, fail)


def _check_obj(name: str, data: bytes, fail: ErrorFactory) -> None:
    if b"\0" in data:
        raise fail(f"mesh {name} cannot be read: it is binary, and OBJ is text")
    _check_lines(name, data, _OBJ_LINE, fail)
    if (curved := _FREE_FORM.search(data)) is not None:
        line = data.count(10, 0, curved.start(1)) + 1
        raise fail(
            f"mesh {name} holds the free-form element {curved[1].decode()!r} in its line {line}, which is not read; a "
            "triangulated export would work"
        )


def _check_libraries(path: Path, data: bytes, fail: ErrorFactory) -> None:
    """Refuse material libraries outside the mesh's folder: the verifier's importer opens what the file names.

    Where none is, nothing is opened; a named pipe would block.
    """
    folder = path.resolve().parent
    for found in _LIBRARY.finditer(data):
        for name in {found[1].strip(), *found[1].split()}:  # names may hold blanks, or follow one another
            library = folder / os.fsdecode(name)
            try:
                there = library.resolve()
                outside = os.path.lexists(library) and not there.is_relative_to(folder)
                special = os.path.lexists(there) and not there.is_file()
                large = there.is_file() and there.stat().st_size > MESH
            except (OSError, RuntimeError, ValueError):
                outside, special, large = True, False, False
            if outside or special or large:
                raise fail(
                    f"mesh {path.name} names the material library {os.fsdecode(name)!r}, which is no ordinary file in "
                    "its folder; the mesh without its mtllib line would work"
                )


def _check_lines(name: str, data: bytes, pattern: re.Pattern[bytes], fail: ErrorFactory) -> None:
    for n, line in enumerate(data.splitlines(), 1):
        if not pattern.fullmatch(line):
            raise fail(f"mesh {name} is damaged in its line {n}: found {line[:60]!r}; a fresh export would work")


def _refuse_too_many(name: str, count: int, fail: ErrorFactory) -> None:
    if count > _MOST_TRIANGLES:
        raise fail(
            f"mesh {name} holds {count} triangles; expected at most {_MOST_TRIANGLES}: a decimated mesh, or its "
            "convex parts, would work"
        )
