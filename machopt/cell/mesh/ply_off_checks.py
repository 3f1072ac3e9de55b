"""Check of PLY and OFF files against their headers: every vertex, every face, every index.

The library of the verifier does not check these files; a wrong count or index crashes its process.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from machopt.cell.mesh.mesh_errors import ErrorFactory

_NUMBER = rb"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_NUMBERS = re.compile(rb"\s*%b(?:\s+%b)*\s*" % (_NUMBER, _NUMBER))
_SIZES = {
    b"char": 1,
    b"int8": 1,
    b"uchar": 1,
    b"uint8": 1,
    b"short": 2,
    b"int16": 2,
    b"ushort": 2,
    b"uint16": 2,
    b"int": 4,
    b"int32": 4,
    b"uint": 4,
    b"uint32": 4,
    b"float": 4,
    b"float32": 4,
    b"double": 8,
    b"float64": 8,
}
_FEWEST, _MOST = 3, 64  # corners of a face


@dataclass(frozen=True)
class MeshCounts:
    vertices: int
    faces: int


def check_ply(name: str, data: bytes, fail: ErrorFactory) -> MeshCounts:
    """Check that the body of a PLY file matches its header.

    Args:
        name: Name of the file, for messages.
        data: Content of the file.
        fail: Function that builds an error from a message.

    Returns:
        Counts of vertices and faces.

    Raises:
        InputError: the file is damaged, or libraries read this kind differently.
    """
    head, mark, body = data.partition(b"end_header")
    lines = head.replace(b"\r", b"").strip().split(b"\n")
    if not mark or lines[0] != b"ply" or len(head) > 65536:
        raise fail(f"mesh {name} cannot be read: it does not begin with a PLY header")
    form = b""
    elements: list[tuple[bytes, int, list[list[bytes]]]] = []
    for n, line in enumerate(lines[1:], 2):
        words = line.split()
        if not words or words[0] in (b"comment", b"obj_info"):
            continue
        if words[0] == b"format" and len(words) == 3:
            form = words[1]
        elif words[0] == b"element" and len(words) == 3 and re.fullmatch(rb"[0-9]{1,12}", words[2]):
            elements.append((words[1], int(words[2]), []))
        elif words[0] == b"property" and elements and _is_property(words[1:]):
            elements[-1][2].append(words[1:])
        else:
            raise fail(f"mesh {name} is damaged in its line {n}: found {line[:60]!r} in the PLY header")
    if form not in (b"ascii", b"binary_little_endian", b"binary_big_endian"):
        raise fail(f"mesh {name} cannot be read: its PLY format is {form!r}; ascii or binary_little_endian would work")
    if [e[0] for e in elements[:2]] != [b"vertex", b"face"]:
        raise fail(f"mesh {name} cannot be read: its header does not count vertices and then faces")
    (_, vertices, of_vertex), (_, faces, of_face) = elements[:2]
    if [p[-1] for p in of_vertex[:3]] != [b"x", b"y", b"z"] or any(p[0] == b"list" for p in of_vertex):
        raise fail(f"mesh {name} cannot be read: its vertices are not given as x, y, z")
    if not of_face or of_face[0][0] != b"list" or of_face[0][-1] not in (b"vertex_indices", b"vertex_index"):
        raise fail(f"mesh {name} cannot be read: its faces are not given as lists of vertex_indices")
    if 3 * vertices + 4 * faces > len(body):  # a number takes a byte and more
        raise fail(
            f"mesh {name} is cut: its header counts {vertices} vertices and {faces} faces, and it holds "
            f"{len(data)} bytes"
        )
    if form == b"ascii":
        rows = [row for row in body.split(b"\n") if row.strip()]
        _check_rows(name, rows, vertices, faces, fail)
    else:
        body = body[2:] if body.startswith(b"\r\n") else body[1:]
        _check_binary(name, body, vertices * sum(_SIZES[p[0]] for p in of_vertex), faces, of_face, fail)
    return MeshCounts(vertices, faces)


def check_off(name: str, data: bytes, fail: ErrorFactory) -> MeshCounts:
    """Check that the body of an OFF file matches its header.

    Args:
        name: Name of the file, for messages.
        data: Content of the file.
        fail: Function that builds an error from a message.

    Returns:
        Counts of vertices and faces.

    Raises:
        InputError: the file is damaged.
    """
    rows = [row for row in (line.split(b"#")[0].strip() for line in data.split(b"\n")) if row]
    counts = rows[1].split() if len(rows) > 1 else []
    if not rows or rows[0] != b"OFF" or len(counts) != 3 or not all(re.fullmatch(rb"[0-9]{1,12}", c) for c in counts):
        raise fail(
            f"mesh {name} cannot be read: it does not begin with OFF and, in a line, the counts of vertices, "
            "faces and edges"
        )
    _check_rows(name, rows[2:], int(counts[0]), int(counts[1]), fail)
    return MeshCounts(int(counts[0]), int(counts[1]))


def _is_property(words: list[bytes]) -> bool:
    if words[:1] == [b"list"]:
        return len(words) == 4 and words[1] in _SIZES and words[2] in _SIZES and not {*words[1:3]} & _REAL
    return len(words) == 2 and words[0] in _SIZES


_REAL = {b"float", b"float32", b"double", b"float64"}


def _check_rows(name: str, rows: list[bytes], vertices: int, faces: int, fail: ErrorFactory) -> None:
    if len(rows) < vertices + faces:
        raise fail(
            f"mesh {name} is cut: its header counts {vertices} vertices and {faces} faces, and {len(rows)} "
            "lines follow; a fresh export would work"
        )
    for row in rows[:vertices]:
        if not _NUMBERS.fullmatch(row) or len(row.split()) < 3:
            raise fail(f"mesh {name} is damaged: found the vertex {row[:60]!r}; a fresh export would work")
    for row in rows[vertices : vertices + faces]:
        words = row.split()
        corners = int(words[0]) if re.fullmatch(rb"[0-9]{1,3}", words[0]) else 0
        index = words[1 : corners + 1]
        if not (
            _FEWEST <= corners <= _MOST
            and len(index) == corners
            and all(re.fullmatch(rb"[0-9]{1,9}", i) and int(i) < vertices for i in index)
            and all(_NUMBERS.fullmatch(w) for w in words[corners + 1 :])
        ):
            raise fail(
                f"mesh {name} is damaged: found the face {row[:60]!r} of {vertices} vertices; a fresh export would work"
            )


def _check_binary(
    name: str, body: bytes, start: int, faces: int, of_face: list[list[bytes]], fail: ErrorFactory
) -> None:
    _, count, index, _ = of_face[0]
    if len(of_face) > 1 or _SIZES[count] != 1 or _SIZES[index] != 4:
        raise fail(
            f"mesh {name} cannot be read: binary PLY is read with faces as one list of uchar int; binary STL would work"
        )
    size = 1 + _FEWEST * 4
    block = body[start : start + faces * size]
    if len(body) < start + faces * size or (np.frombuffer(block, np.uint8).reshape(faces, size)[:, 0] != _FEWEST).any():
        raise fail(
            f"mesh {name} is cut or damaged, or its faces are not all triangles; a fresh export as STL would work"
        )
