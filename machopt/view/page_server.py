"""HTTP server of a page for one user: loopback address, secret token, requests to this host only.

A browser lets any page send requests to 127.0.0.1, and a host name that resolves to it passes for the page's own host
(DNS rebinding). So the address holds a secret token, and a request must name this very host. Threads read the
requests. The thread that called :meth:`PageServer.work` carries out their actions, one at a time, so that Ctrl-C
stops a running plan like any other.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import queue
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from machopt.data_types.documents.document_base import DocumentModel
from machopt.data_types.documents.view_document import ViewAnswerDocument, ViewProgressDocument

HOST = "127.0.0.1"
MAX_REQUEST_BYTES = 1_000_000  # bytes of a request
CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


@dataclass
class PendingAction:
    """Requested action and its answer."""

    name: str
    body: dict[str, Any]
    answer: ViewAnswerDocument | None = None
    finished: threading.Event = field(default_factory=threading.Event)


class PageServer:
    """HTTP server of a page; only :meth:`serve_actions` calls ``page`` and ``act``."""

    def __init__(
        self,
        page: Callable[[], str],
        act: Callable[[str, dict[str, Any], Callable[[str], None]], ViewAnswerDocument],
        actions: tuple[str, ...],
        port: int = 0,
    ) -> None:
        """
        Args:
            page: the page as it is now.
            act: does one of the actions with what was sent, telling its stages; the answer is sent as JSON.
            actions: their names.
            port: 0 for any that is free.
        """
        self.token = secrets.token_urlsafe(18)
        self.actions = actions
        self._page, self._act = page, act
        self._html = page()
        self._queue: queue.SimpleQueue[PendingAction] = queue.SimpleQueue()
        self._busy = threading.Lock()
        self._stage, self._since = "", 0.0
        self._open = True
        handler = type("Handler", (_RequestHandler,), {"owner": self})
        self._http = ThreadingHTTPServer((HOST, port), handler)
        self._http.daemon_threads = False  # closing waits for what is being answered
        self._thread = threading.Thread(target=self._http.serve_forever, args=(0.1,), name="machopt view")
        self._thread.start()

    @property
    def port(self) -> int:
        return int(self._http.server_address[1])

    @property
    def url(self) -> str:
        """The page's address, token included."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    @property
    def hosts(self) -> tuple[str, ...]:
        """Host names that a request may use."""
        return f"{HOST}:{self.port}", f"localhost:{self.port}"

    @property
    def html(self) -> str:
        return self._html

    @property
    def progress(self) -> ViewProgressDocument:
        """Current stage of the running action."""
        return ViewProgressDocument(stage=self._stage, seconds=time.monotonic() - self._since if self._stage else 0.0)

    def serve_actions(self) -> None:
        """Carry out requested actions until :class:`KeyboardInterrupt`."""
        while True:
            self.run_action(self.wait_for_action())

    def wait_for_action(self, seconds: float | None = None) -> PendingAction:
        """Wait for the next action.

        Args:
            seconds: Longest wait, s; None waits for ever.

        Raises:
            queue.Empty: no action came in time.
        """
        return self._queue.get(timeout=seconds)

    def run_action(self, action: PendingAction) -> None:
        """Carry out one action.

        Args:
            action: The action.
        """
        self._since = time.monotonic()
        try:
            action.answer = self._act(action.name, action.body, self._set_progress)
            if action.answer.shown or action.answer.checks:
                self._html = self._page()
        finally:
            self._stage = ""
            action.finished.set()

    def request_action(self, what: str, body: dict[str, Any]) -> ViewAnswerDocument | None:
        """Request an action and wait for it; None where another one is running, or the server is closed.

        Args:
            what: Name of the action.
            body: Data of the request.
        """
        if not self._busy.acquire(blocking=False):
            return None
        try:
            action = PendingAction(what, body)
            self._queue.put(action)
            while self._open and not action.finished.wait(0.1):
                pass
            return action.answer
        finally:
            self._busy.release()

    def close(self) -> None:
        """Stop the server and release waiting requests."""
        self._open = False
        self._http.shutdown()
        self._thread.join()
        self._http.server_close()

    def _set_progress(self, stage: str) -> None:
        self._stage = stage


class _RequestHandler(BaseHTTPRequestHandler):
    """One request."""

    owner: PageServer
    timeout = 2.0  # s, of a silent connection: closing waits for it
    server_version, sys_version = "machopt", ""

    def do_GET(self) -> None:
        path = self._parse_path()
        if path == "":
            self._send(HTTPStatus.OK, self.owner.html, "text/html; charset=utf-8")
        elif path == "progress":
            self._send_json(self.owner.progress)
        elif path is not None:
            self._send_refusal(HTTPStatus.NOT_FOUND, "there is nothing of this name")

    def do_POST(self) -> None:
        path = self._parse_path()
        if path is None:
            return None
        if path not in self.owner.actions:
            return self._send_refusal(HTTPStatus.NOT_FOUND, "there is nothing of this name")
        if self.headers.get("Content-Type", "").partition(";")[0].strip() != "application/json":
            return self._send_refusal(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "application/json would work")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()) or int(length) > MAX_REQUEST_BYTES:
            return self._send_refusal(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"up to {MAX_REQUEST_BYTES} bytes would work"
            )
        try:
            body = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):  # the latter of brackets within brackets
            body = None
        if not isinstance(body, dict):
            return self._send_refusal(HTTPStatus.BAD_REQUEST, "a JSON object would work")
        answer = self.owner.request_action(path, body)
        if answer is None:
            return self._send_json(
                ViewAnswerDocument(message="Something is being done already.", good=False), HTTPStatus.CONFLICT
            )
        return self._send_json(answer)

    def _parse_path(self) -> str | None:
        """Return the requested path behind the token; None where the request was refused."""
        origin = self.headers.get("Origin")
        if self.headers.get("Host") not in self.owner.hosts or (
            origin is not None and origin not in [f"http://{host}" for host in self.owner.hosts]
        ):
            self._send_refusal(HTTPStatus.FORBIDDEN, "this page is for this machine alone")
            return None
        token, slash, rest = self.path.partition("?")[0].removeprefix("/").partition("/")
        if not slash or not hmac.compare_digest(token.encode("utf-8", "replace"), self.owner.token.encode()):
            self._send_refusal(HTTPStatus.FORBIDDEN, "the address that machopt view printed would work, with its token")
            return None
        return rest

    def _send_refusal(self, status: HTTPStatus, why: str) -> None:
        self._send(status, why + "\n", "text/plain; charset=utf-8")

    def _send_json(self, value: DocumentModel, status: HTTPStatus = HTTPStatus.OK) -> None:
        self._send(status, json.dumps(value.to_json_types(), ensure_ascii=False), "application/json; charset=utf-8")

    def _send(self, status: HTTPStatus, text: str, kind: str) -> None:
        data = text.encode()
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(data))),
            ("Content-Security-Policy", CONTENT_SECURITY_POLICY),
            ("Cache-Control", "no-store"),
            ("Referrer-Policy", "no-referrer"),
            ("X-Content-Type-Options", "nosniff"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
        ):
            self.send_header(name, value)
        self.end_headers()
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the page was closed
            self.wfile.write(data)

    def log_message(self, *_: object) -> None:
        """Log nothing, because the address holds the token.

        Args:
            _: The arguments, ignored.
        """
