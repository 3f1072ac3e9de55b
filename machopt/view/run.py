"""``machopt view``: what is served, and the actions of the page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from machopt.cell.cell_reader import load_cell
from machopt.commands.input_hashes import list_request_paths
from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.data_types.documents.view_document import ViewAnswerDocument
from machopt.errors import InputError
from machopt.options.plan_option_reader import format_user_options, load_options
from machopt.output.manifest_file import MANIFEST, read_manifest
from machopt.toolpath.reading_options import parse_reading_options
from machopt.verification.folder.allowed_files import find_unreadable_files
from machopt.view.cell_page import build_cell_html
from machopt.view.input_locations import list_changed_inputs, locate_inputs
from machopt.view.page_server import PageServer
from machopt.view.session import ViewSession

ACTIONS = ("plan", "back", "save", "verify", "outcome")


@dataclass(frozen=True, kw_only=True)
class ViewRequest:
    """Request of ``machopt view``."""

    paths: tuple[Path, ...]  # OUT; CELL; CELL TOOLPATH; OUT CELL TOOLPATH
    request: OptimizeRequest  # options, reading and so on; its paths are not used
    save: Path  # where the plan file goes
    words: tuple[str, ...] = ()  # of the reading options, for the command that plans the same
    port: int = 0
    report_only: bool = False  # a report is shown, not planned anew


def serve_view(view_request: ViewRequest, say: Callable[[str], None], progress: Callable[[str], None]) -> PageServer:
    """Load or plan, and start the server; :meth:`PageServer.work` carries out the page's actions.

    Args:
        view_request: The request of ``machopt view``.
        say: Called with each message to the user.
        progress: Called with the name of each stage when it begins.

    Raises:
        InputError: the input cannot be shown or planned.
    """
    places = list(view_request.paths)
    out = places.pop(0) if (places[0] / MANIFEST).is_file() else None
    if out is not None:
        for name, why in find_unreadable_files(out, read_manifest(out)[0])[:1]:
            raise InputError(why, file=out / name)
    if out is not None and not places:
        places = [] if view_request.report_only else _locate_inputs(out, say)
        if not places:
            return _serve_report(out, view_request.port)
    if len(places) == 1:
        cell = load_cell(places[0], allow_external=view_request.request.allow_external)
        say("a cell by itself; with a toolpath (machopt view CELL TOOLPATH) it is planned and can be steered")
        return _serve_fixed_page(build_cell_html(cell), view_request.port)
    if len(places) != 2:
        raise InputError("too many places; OUT, CELL, CELL TOOLPATH or OUT CELL TOOLPATH would work", where="view")
    request = _build_optimize_request(view_request, out, *places)
    given = load_optimize_inputs(request)
    if out is not None and (other := list_changed_inputs(read_manifest(out)[0].inputs, given.manifest.inputs)):
        say(f"{', '.join(other)} changed since {out} was made: the plan is that of today's files")
    session = ViewSession.start(
        given,
        view_request.save,
        _list_command_words(view_request, *places),
        progress,
        overwrite=request.overwrite,
        inputs=(*given.cell.files, *list_request_paths(request), *list_request_paths(view_request.request)),
    )
    return PageServer(session.build_html, SessionActions(session).run_action, ACTIONS, view_request.port)


@dataclass(frozen=True)
class SessionActions:
    """Actions of the page of a session."""

    session: ViewSession

    def run_action(self, what: str, body: dict[str, Any], progress: Callable[[str], None]) -> ViewAnswerDocument:
        """Carry out one action; an input error becomes part of the answer.

        Args:
            what: Name of the action.
            body: Data of the request.
            progress: Called with the name of each stage when it begins.
        """
        try:
            if what == "plan":
                message, shown = self.session.replan(body, progress)
                return ViewAnswerDocument(message=message, good=shown, shown=shown)
            if what == "back":
                self.session.swap_plans()
                return ViewAnswerDocument(message=self.session.message, good=self.session.has_motion, shown=True)
            if what == "verify":
                return self.session.verify(progress)
            if what == "outcome":
                return self.session.find_outcome(body)
            command = self.session.save_plan_file()
            return ViewAnswerDocument(message=f"Saved {self.session.file}: {command}", good=True, saved=True)
        except InputError as problem:
            return ViewAnswerDocument(message=problem.reason, good=False, shown=False)


def _locate_inputs(out: Path, say: Callable[[str], None]) -> list[Path]:
    """Cell and toolpath of an output folder where both can be found, else nothing and what to give."""
    manifest = read_manifest(out)[0]
    if manifest.command != "optimize":
        return []
    origin = locate_inputs(out, manifest, [Path.cwd()])
    if origin.cell is None or origin.toolpath is None:
        say(
            f"a report by itself: no file around {out} has the hash of its {' and its '.join(origin.missing)}; "
            "machopt view OUT CELL TOOLPATH steers it"
        )
        return []
    say(f"steering {origin.cell} with {origin.toolpath}, found by their hashes; --as-it-is only shows the report")
    return [origin.cell, origin.toolpath]


def _serve_report(out: Path, port: int) -> PageServer:
    page = out / "report.html"
    if not page.is_file():
        raise InputError("holds no report.html; an output folder of optimize would work", file=out)
    return _serve_fixed_page(page.read_text(encoding="utf-8"), port)


def _serve_fixed_page(text: str, port: int) -> PageServer:
    return PageServer(lambda: text, lambda *_: ViewAnswerDocument(message="", good=False), (), port)


def _build_optimize_request(view_request: ViewRequest, out: Path | None, cell: Path, toolpath: Path) -> OptimizeRequest:
    """The job, under the options an output folder was made with where one is given."""
    request = replace(view_request.request, cell=cell, toolpath=toolpath)
    if out is None:
        return request
    manifest = read_manifest(out)[0]
    if manifest.command != "optimize":
        raise InputError(f"was made by {manifest.command}; an output folder of optimize would work", file=out)
    reading = {**parse_reading_options(manifest.reading), **{k: v for k, v in request.reading.items() if v}}
    options = load_options(dict(manifest.options), request.plan_file, request.overrides)
    return replace(request, reading=reading, plan_file=None, overrides=(), direct=format_user_options(options))


def _list_command_words(view_request: ViewRequest, cell: Path, toolpath: Path) -> tuple[str, ...]:
    return str(cell), str(toolpath), "-o", "steered", *view_request.words
