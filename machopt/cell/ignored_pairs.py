"""Key ``ignore_pairs`` of cell.yaml: body pairs that may touch, by name or by an SRDF, resolved to single bodies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from machopt.cell.urdf import UrdfModel
from machopt.cell.urdf.srdf_reader import read_srdf
from machopt.cell.urdf.xacro_expansion import is_xacro
from machopt.data_types.cell import CollisionShape, IgnoredPair, Tool, Workpiece
from machopt.errors import CellError, suggest_nearest_word
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument

FileOpener = Callable[[KeyPath, str], Path]


class IgnoredPairReader:
    """Names of links and bodies, as pairs may give them.

    A link means all its collision bodies, the flange for those of the tool where it has none itself, ``world`` for
    obstacles and a workpiece that stand still, ``tool`` and ``workpiece`` for theirs, ``cutter`` for the cutter.

    Attributes:
        warnings: pairs of the cell that name nothing with a body.
    """

    def __init__(
        self,
        urdf: UrdfModel,
        flange_link: str,
        tool: Tool,
        workpiece: Workpiece,
        obstacles: tuple[CollisionShape, ...],
        document: YamlDocument,
    ) -> None:
        self._urdf, self._document = urdf, document
        # collision bodies are named after their link and counted, as the robot model names them
        self._links = {p.name: tuple(f"{p.name}_{n}" for n in range(p.collisions)) for p in urdf.parts}
        shapes = (*tool.geometry, *workpiece.geometry, *obstacles)
        self._bodies = {s.name: (s.name,) for s in shapes}
        self._groups = {
            "tool": tuple(s.name for s in tool.geometry),
            "workpiece": tuple(s.name for s in workpiece.geometry),
            "cutter": ("cutter",) if tool.cutter is not None else (),
            "world": tuple(s.name for s in obstacles if s.link == "world")
            + tuple(s.name for s in workpiece.geometry if workpiece.link == "world"),
        }
        self._flange = flange_link
        self.warnings: list[str] = []

    def pairs(self, given: list[str | list[str]], open_file: FileOpener) -> tuple[IgnoredPair, ...]:
        """Resolve ``ignore_pairs``, in its order.

        Args:
            given: the value of the key.
            open_file: a file the cell names, by key path and name.

        Raises:
            InputError: a name that nothing has, or that two bodies have, a pair of a body with itself, no SRDF.
        """
        if given:
            self._check_unique_names()
        out: list[IgnoredPair] = []
        for n, entry in enumerate(given):
            loc: KeyPath = ("ignore_pairs", n)
            if isinstance(entry, str):
                out += self._read_srdf(loc, entry, open_file)
                continue
            a, b = entry
            first, second = self._find_bodies(a, (*loc, 0)), self._find_bodies(b, (*loc, 1))
            if set(first) & set(second):
                raise self._document.build_error(
                    loc, f"found {a!r} and {b!r}, which share a body; expected two that move"
                )
            for word, bodies in ((a, first), (b, second)):
                if not bodies:
                    where = self._document.locate_key(loc)
                    self.warnings.append(f"{where}: {word!r} has no body that could touch anything")
            out.append(IgnoredPair(a, b, first, second, "ignore_pairs of cell.yaml"))
        return tuple(out)

    def _check_unique_names(self) -> None:
        """Refuse a second body of a name: pairs are given by name, so it would be ignored with the first."""
        taken = {body: f"a body of link {link}" for link, bodies in self._links.items() for body in bodies}
        taken |= dict.fromkeys(self._groups["cutter"], "the tool's cutter")
        for name in self._bodies:
            if name in taken:
                raise self._document.build_error(
                    ("ignore_pairs",),
                    f"a body of the cell is named {name!r} like {taken[name]}; another name would work",
                )

    def _read_srdf(self, loc: KeyPath, name: str, open_file: FileOpener) -> tuple[IgnoredPair, ...]:
        """The pairs of links that this robot has and that have bodies; an SRDF often speaks of a larger one.

        Links with one joint between them, which it lists too, are never compared.
        """
        path = open_file(loc, name)
        if is_xacro(path):
            raise CellError("is a xacro file; the SRDF that it expands to would work", file=path)
        out, srdf = [], read_srdf(path, self._urdf.links)
        if srdf and not any({pair.link1, pair.link2} <= set(self._links) for pair in srdf):
            self.warnings.append(
                f"{self._document.locate_key(loc)}: {path.name} names no two links of this robot in any of its "
                f"{len(srdf)} "
                f"pairs (its first is {srdf[0].link1} ~ {srdf[0].link2}), so it lets nothing touch"
            )
        for pair in srdf:
            first, second = self._links.get(pair.link1, ()), self._links.get(pair.link2, ())
            if first and second and self._count_joints_between(pair.link1, pair.link2) > 1:
                why = f"{path.name} line {pair.line}" + (f": {pair.reason}" if pair.reason else "")
                out.append(IgnoredPair(pair.link1, pair.link2, first, second, why))
        return tuple(out)

    def _count_joints_between(self, a: str, b: str) -> int:
        """Moving joints from one link to the other."""
        ways = [{j.name for j in self._urdf.chain(link) if j.moves} for link in (a, b)]
        return len(ways[0] ^ ways[1])

    def _find_bodies(self, word: str, loc: KeyPath) -> tuple[str, ...]:
        by_name = [bodies for kind in (self._links, self._bodies) if (bodies := kind.get(word)) is not None]
        if len(by_name) > 1:
            raise self._document.build_error(
                loc, f"{word!r} names a link and a body; another name for the body would work"
            )
        if by_name and by_name[0]:
            return by_name[0]
        if by_name:  # a link without bodies of its own, as the flange and the URDF's "world" mostly are
            return self._groups["tool"] if word == self._flange else self._groups.get(word, ())
        if word in self._groups:
            return self._groups[word]
        single = {body: (body,) for bodies in self._links.values() for body in bodies}
        if word in single:
            return single[word]
        known = [*self._links, *self._bodies, *self._groups]
        raise self._document.build_error(
            loc, f"{word!r} is no link and no body of the cell; {suggest_nearest_word(word, known)}"
        )
