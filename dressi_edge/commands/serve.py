"""The page of a run while it runs: a server on this machine's loopback alone, with a token in its address.

In: events and courses of a run, and now and then its model and pictures. Out: answers to one page that asks for news, and what its
buttons ask for. A server's thread never touches the session: it gives what `refresh` has left. Whoever lacks the token gets 403, as does a
request for another host's name (a page elsewhere whose name leads here) or from another origin.
"""
from __future__ import annotations

import hmac
import json
import secrets
import threading
import time
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

from ..cache.errors import InputError
from ..page import result
from ..page.html import LIVE, page
from .solve import Course

HOST = "127.0.0.1"
LAST = 3.0  # seconds that the end waits for the page to see it


class Live:
    """What the page is told, and what it asks for. A sink of events."""

    def __init__(self, port: int, title: str):
        self.token, self.title = secrets.token_urlsafe(24), title
        self.courses: Mapping[str, Course] = {}
        self.start: dict = {}  # of the page: what does not change
        self.model, self.pictures, self.version = b"", b"[]", 0
        self.subtitle, self.left, self.views, self.over = "", {}, {}, ""
        self._asked, self._seen, self._polled = set(), threading.Event(), -1e9
        self.keep = None  # called when a checkpoint is asked for
        try:
            self._server = ThreadingHTTPServer((HOST, port), _handler(self))
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or error
            raise InputError(f"--serve {port}: {why}; give another port, or none for a free one") from None
        self._server.daemon_threads = True
        self.port = self._server.server_address[1]
        self.address = f"http://{HOST}:{self.port}/?token={self.token}"
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.2}, daemon=True).start()

    def __call__(self, event: str, facts: Mapping) -> None:
        if event == "doing":
            so_far = f" {facts['done']} of {facts['total']}" if "total" in facts else ""
            self.subtitle = f"{facts['what']}{so_far}"
        elif event in ("phase", "step", "stopped"):
            self.subtitle = f"{facts['phase']}: step {facts['done']} of {facts['steps']}"
            if event == "step":
                self.left = {facts["phase"]: facts["seconds_left"]}

    def stop(self) -> str:
        """Why the run is to stop, or nothing."""
        return "stop" if "stop" in self._asked else ""

    def ask(self, what: str) -> None:
        """A button of the page."""
        self._asked.add(what)
        if what == "checkpoint" and self.keep is not None:
            self.keep()

    def begin(self, session, courses: Mapping[str, Course], before) -> None:
        """The page's data at the start."""
        self.courses, self.before = courses, before
        self.start = result.run_data(session, self.title, (), before)
        self.refresh(session)

    def refresh(self, session) -> None:
        """Model and pictures as they are now."""
        self.model = result.model(session) or b""
        self.pictures = json.dumps(result.pictures(session, self.before)).encode()
        self.views = result.results.plain(result.results.measured(session))
        self.version += 1

    def news(self) -> dict:
        """What the page asks for again and again."""
        self._polled = time.monotonic()
        over = self.over
        if over:
            self._seen.set()
        courses = list(self.courses.values())
        data = {"phases": [{"name": c.phase, "of": c.steps, "seconds_left": self.left.get(c.phase), **c.record()} for c in courses],
                "views": self.views, "curves": result.curves(courses), "subtitle": over or self.subtitle}
        return {"data": result.results.plain(data), "model": self.version if self.model else 0, "pictures": self.version,
                "begun": bool(self.start), "over": bool(over)}

    def page(self) -> bytes:
        """The page as it is asked for first."""
        live = {"checkpoint": self.keep is not None, "begun": bool(self.start)}
        return page({"title": self.title, **self.start, "pictures": [], "live": live, "footer": "Live, on this machine alone."}, live=True)

    def close(self, why: str) -> None:
        """The end: whoever looks sees it."""
        self.over = why
        if time.monotonic() - self._polled < LAST:
            self._seen.wait(LAST)
            time.sleep(0.2)  # its last questions
        self._server.shutdown()
        self._server.server_close()


def _handler(live: Live) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = 10
        server_version, sys_version = "dressi_edge", ""

        def do_GET(self) -> None:
            answers = {"/": ("text/html; charset=utf-8", live.page),
                       "/data": ("application/json", lambda: json.dumps(live.news()).encode()),
                       "/pictures": ("application/json", lambda: live.pictures), "/model": ("model/gltf-binary", lambda: live.model)}
            if self._allowed():
                kind, make = answers.get(self._path, (None, None))
                self._answer(200, make(), kind) if make else self._answer(404)

        def do_POST(self) -> None:
            if self._allowed():
                if self._path in ("/stop", "/checkpoint"):
                    live.ask(self._path[1:])
                    self._answer(204)
                else:
                    self._answer(404)

        def _allowed(self) -> bool:
            """Whether it is our page that asks: else 403 is answered."""
            address = urlsplit(self.path)
            self._path = address.path
            hosts = {f"{name}:{live.port}" for name in (HOST, "localhost")}
            own = f"http://{HOST}:{live.port}"
            token = parse_qs(address.query).get("token", [""])[0]
            fine = (self.headers.get("Host") in hosts and hmac.compare_digest(token.encode(), live.token.encode())
                    and self.headers.get("Origin", own) in {own, *(f"http://{host}" for host in hosts)}
                    and self.headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin"))
            if not fine:
                self._answer(403)
            return fine

        def _answer(self, code: int, body: bytes = b"", kind: str = "text/plain") -> None:
            self.send_response(code)
            for name, value in (("Content-Type", kind), ("Content-Length", str(len(body))), ("Cache-Control", "no-store"),
                                ("Content-Security-Policy", LIVE + "; frame-ancestors 'none'"), ("X-Content-Type-Options", "nosniff"),
                                ("Referrer-Policy", "no-referrer"), ("Cross-Origin-Resource-Policy", "same-origin")):
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_) -> None:
            pass

    return Handler
