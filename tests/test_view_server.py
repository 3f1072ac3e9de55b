"""Server of ``machopt view``: local access only, and only with the token."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from machopt.data_types.documents.view_document import ViewAnswerDocument
from machopt.view.page_server import HOST, MAX_REQUEST_BYTES, PageServer

DONE = ViewAnswerDocument(message="", good=True)


@contextmanager
def serve_page(
    act: Callable[..., ViewAnswerDocument], page: Callable[[], str] = lambda: "<p>page</p>"
) -> Iterator[PageServer]:
    server = PageServer(page, act, ("plan",))
    try:
        yield server
    finally:
        server.close()


def ask(
    server: PageServer, method: str, path: str, body: str | None = None, **headers: str
) -> tuple[int, str, dict[str, str]]:
    """Return status, text and headers of a response; the token precedes ``path`` unless it begins with a slash."""
    connection = http.client.HTTPConnection(HOST, server.port, timeout=10)
    try:
        where = path if path.startswith("/") else f"/{server.token}/{path}"
        named = {k.replace("_", "-"): v for k, v in headers.items()}
        connection.request(method, where, body, named)
        answer = connection.getresponse()
        return answer.status, answer.read().decode(), dict(answer.headers)
    finally:
        connection.close()


def test_page_is_served_with_the_token() -> None:
    with serve_page(lambda *_: DONE) as server:
        assert server.url == f"http://127.0.0.1:{server.port}/{server.token}/"
        assert len(server.token) >= 24  # 18 random bytes
        status, text, headers = ask(server, "GET", "")
        assert (status, text) == (200, "<p>page</p>")
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["Cache-Control"] == "no-store"
        assert ask(server, "GET", "progress")[1] == '{"stage": "", "seconds": 0.0}'
        assert ask(server, "GET", "elsewhere")[0] == 404


@pytest.mark.parametrize("path", ["/", "/progress", "/x/", "/favicon.ico", "/../etc/passwd", "//"])
def test_nothing_is_served_without_the_token(path: str) -> None:
    with serve_page(lambda *_: DONE) as server:
        for method in ("GET", "POST"):
            status, text, _ = ask(server, method, path, "{}", Content_Type="application/json")
            assert status == 403
            assert "page" not in text
            assert server.token not in text


def test_other_hosts_and_origins_are_refused() -> None:
    """A host name that resolves to 127.0.0.1 lets a foreign page send requests
    with its own host name (DNS rebinding)."""
    with serve_page(lambda *_: DONE) as server:
        for host in ("evil.example", f"evil.example:{server.port}", "127.0.0.1", f"127.0.0.1:{server.port + 1}", ""):
            assert ask(server, "GET", "", Host=host)[0] == 403
        assert ask(server, "GET", "", Host=f"localhost:{server.port}")[0] == 200
        assert ask(server, "GET", "", Origin="http://evil.example")[0] == 403
        assert ask(server, "GET", "", Origin="null")[0] == 403
        assert ask(server, "GET", "", Origin=f"http://127.0.0.1:{server.port}")[0] == 200


def test_invalid_requests_are_refused() -> None:
    with serve_page(lambda *_: DONE) as server:
        json_ = "application/json"
        assert ask(server, "POST", "plan", "{}", Content_Type="text/plain")[0] == 415
        assert ask(server, "POST", "plan", "[1]", Content_Type=json_)[0] == 400
        assert ask(server, "POST", "plan", "{", Content_Type=json_)[0] == 400
        assert ask(server, "POST", "plan", "[" * 100_000, Content_Type=json_)[0] == 400
        # str.isdigit() accepts this character
        assert ask(server, "POST", "plan", "", Content_Type=json_, Content_Length="\xb2")[0] == 413
        assert ask(server, "POST", "other", "{}", Content_Type=json_)[0] == 404
        assert ask(server, "POST", "plan", "", Content_Type=json_, Content_Length=str(MAX_REQUEST_BYTES + 1))[0] == 413


def test_requests_are_executed_one_at_a_time() -> None:
    """A second request during execution is refused with status 409;
    the page is rebuilt after a change of its content."""
    pages = iter(["first", "second", "third"])
    doers: list[int] = []

    def act(what: str, body: dict[str, Any], progress: Callable[[str], None]) -> ViewAnswerDocument:
        doers.append(threading.get_ident())
        progress("smooth")
        observed.append(server.progress.stage)
        busy.append(ask(server, "POST", "plan", "{}", Content_Type="application/json")[0])
        return ViewAnswerDocument(message=f"{what} {body['x']}", good=True, shown=True)

    observed: list[str] = []
    busy: list[int] = []
    with serve_page(act, lambda: next(pages)) as server:
        found: list[tuple[int, str]] = []
        page = threading.Thread(
            target=lambda: found.append(ask(server, "POST", "plan", '{"x": 3}', Content_Type="application/json")[:2])
        )
        page.start()
        server.run_action(server.wait_for_action())
        page.join()
        assert found[0][0] == 200
        assert json.loads(found[0][1]) == {"message": "plan 3", "good": True, "shown": True}
        assert (doers, observed, busy) == ([threading.get_ident()], ["smooth"], [409])
        assert ask(server, "GET", "")[1] == "second"
        assert server.progress.stage == ""


def test_waiting_requests_are_released_at_the_end() -> None:
    with serve_page(lambda *_: DONE) as server:
        found: list[int] = []
        page = threading.Thread(
            target=lambda: found.append(ask(server, "POST", "plan", "{}", Content_Type="application/json")[0])
        )
        page.start()
        server.wait_for_action()  # the page waits for the response now
    page.join()
    assert found == [409]
