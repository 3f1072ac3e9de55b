"""``machopt view``: what is served, and what a request does to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from machopt.domain.results.view import ViewAnswer
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.options import load_options, options_as_user
from machopt.formats.reading import reading_from_user
from machopt.output.manifest import MANIFEST, read_manifest
from machopt.recheck.folder_files import find_unreadable_files
from machopt.report.cell_page import cell_html
from machopt.services.inputs import paths_read
from machopt.services.load import OptimizeRequest, load
from machopt.view.origin import changed, origin_of
from machopt.view.server import Server
from machopt.view.session import Session

ACTIONS = ("plan", "back", "save", "verify")


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What the user wants to see."""

    places: tuple[Path, ...]  # OUT; CELL; CELL TOOLPATH; OUT CELL TOOLPATH
    request: OptimizeRequest  # options, reading and so on; its places are not looked at
    save: Path  # where the plan file goes
    words: tuple[str, ...] = ()  # of the reading options, for the command that plans the same
    port: int = 0
    as_it_is: bool = False  # a report is shown, not planned anew


def serve(asked: Asked, say: Callable[[str], None], progress: Callable[[str], None]) -> Server:
    """Load or plan, and begin to serve; :meth:`Server.work` does what the page asks.

    Raises:
        InputError: what cannot be shown or planned.
    """
    places = list(asked.places)
    out = places.pop(0) if (places[0] / MANIFEST).is_file() else None
    if out is not None:
        for name, why in find_unreadable_files(out, read_manifest(out)[0])[:1]:
            raise InputError(why, file=out / name)
    if out is not None and not places:
        places = [] if asked.as_it_is else _found(out, say)
        if not places:
            return _report(out, asked.port)
    if len(places) == 1:
        cell = load_cell(places[0], allow_external=asked.request.allow_external)
        say("a cell by itself; with a toolpath (machopt view CELL TOOLPATH) it is planned and can be steered")
        return _fixed(cell_html(cell), asked.port)
    if len(places) != 2:
        raise InputError("too many places; OUT, CELL, CELL TOOLPATH or OUT CELL TOOLPATH would work", where="view")
    request = _request(asked, out, *places)
    given = load(request)
    if out is not None and (other := changed(read_manifest(out)[0].inputs, given.manifest.inputs)):
        say(f"{', '.join(other)} changed since {out} was made: the plan is that of today's files")
    session = Session.begun(
        given,
        asked.save,
        _words(asked, *places),
        progress,
        overwrite=request.overwrite,
        inputs=(*given.cell.files, *paths_read(request), *paths_read(asked.request)),
    )
    return Server(session.html, Acting(session).act, ACTIONS, asked.port)


@dataclass(frozen=True)
class Acting:
    """Does what the page of a session asks."""

    session: Session

    def act(self, what: str, body: dict[str, Any], progress: Callable[[str], None]) -> ViewAnswer:
        """One action; a mistake of the user's is an answer."""
        try:
            if what == "plan":
                told, shown = self.session.replan(body, progress)
                return ViewAnswer(told=told, good=shown, shown=shown)
            if what == "back":
                self.session.back()
                return ViewAnswer(told=self.session.told, good=self.session.good, shown=True)
            if what == "verify":
                return self.session.verified(progress)
            command = self.session.save()
            return ViewAnswer(told=f"Saved {self.session.file}: {command}", good=True, saved=True)
        except InputError as problem:
            return ViewAnswer(told=problem.reason, good=False, shown=False)


def _found(out: Path, say: Callable[[str], None]) -> list[Path]:
    """Cell and toolpath of an output folder where both can be found, else nothing and what to give."""
    manifest = read_manifest(out)[0]
    if manifest.command != "optimize":
        return []
    origin = origin_of(out, manifest, [Path.cwd()])
    if origin.cell is None or origin.toolpath is None:
        say(
            f"a report by itself: no file around {out} has the hash of its {' and its '.join(origin.missing)}; "
            "machopt view OUT CELL TOOLPATH steers it"
        )
        return []
    say(f"steering {origin.cell} with {origin.toolpath}, found by their hashes; --as-it-is only shows the report")
    return [origin.cell, origin.toolpath]


def _report(out: Path, port: int) -> Server:
    page = out / "report.html"
    if not page.is_file():
        raise InputError("holds no report.html; an output folder of optimize would work", file=out)
    return _fixed(page.read_text(encoding="utf-8"), port)


def _fixed(text: str, port: int) -> Server:
    return Server(lambda: text, lambda *_: ViewAnswer(told="", good=False), (), port)


def _request(asked: Asked, out: Path | None, cell: Path, toolpath: Path) -> OptimizeRequest:
    """The job, under the options an output folder was made with where one is given."""
    request = replace(asked.request, cell=cell, toolpath=toolpath)
    if out is None:
        return request
    manifest = read_manifest(out)[0]
    if manifest.command != "optimize":
        raise InputError(f"was made by {manifest.command}; an output folder of optimize would work", file=out)
    reading = {**reading_from_user(manifest.reading), **{k: v for k, v in request.reading.items() if v}}
    options = load_options(dict(manifest.options), request.plan_file, request.overrides)
    return replace(request, reading=reading, plan_file=None, overrides=(), direct=options_as_user(options))


def _words(asked: Asked, cell: Path, toolpath: Path) -> tuple[str, ...]:
    return str(cell), str(toolpath), "-o", "steered", *asked.words
