"""The live page of a run: for whoever has its address, on this machine alone; it shows how it goes, and its buttons work."""

import http.client
import json
import socket
import time
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from browser import Browser, chromium
from jobs import TINY, command, write_job
from test_run import middle, rest, started, until

LONG = TINY.replace("steps = 3", "steps = 200000").replace("steps = 2\n", "steps = 10\n")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    folder = tmp_path_factory.mktemp("live")
    made = command("compile", write_job(folder, LONG), "-p", "lavapipe", "-o", folder / "x.dressi")
    assert made.returncode == 0, made.stderr
    return folder / "x.dressi"


class Served:
    """A run with --serve on its way: `ask(path)` as its page asks; it is stopped at the end."""

    def __init__(self, *args):
        self.process = started(*args, "--serve")
        self.events = until(self.process, middle("shape"))
        self.address = next(e["address"] for e in self.events if e["event"] == "serving")
        found = urlsplit(self.address)
        self.host, self.port, self.token = found.hostname, found.port, parse_qs(found.query)["token"][0]

    def ask(self, path, method="GET", token=None, headers=()):
        """(status, headers, body)"""
        connection = http.client.HTTPConnection(self.host, self.port, timeout=30)
        text = f"?token={self.token}" if token is None else token
        connection.request(method, path + text, headers=dict(headers))
        answer = connection.getresponse()
        body = answer.read()
        connection.close()
        return answer.status, dict(answer.getheaders()), body

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.terminate()
        self.process.communicate(timeout=60)


@pytest.fixture(scope="module")
def served(bundle):
    with Served(bundle) as s:
        yield s


def test_it_listens_on_loopback_alone_at_an_address_nobody_guesses(served):
    assert served.host == "127.0.0.1" and len(served.token) >= 32
    others = {found[4][0] for found in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {"127.0.0.1"}
    for other in others:
        if not other.startswith("127."):
            with pytest.raises(OSError):
                socket.create_connection((other, served.port), timeout=2).close()


@pytest.mark.parametrize("path", ["/", "/data", "/pictures", "/model", "/none"])
@pytest.mark.parametrize("token", ["", "?token=", "?token=x", "?token=%ff%00", "?Token=x"])
def test_without_the_token_nothing_is_told(served, path, token):
    assert served.ask(path, token=token)[0] == 403 and served.ask(path, token=token)[2] == b""


@pytest.mark.parametrize("headers", [{"Host": "example.com"}, {"Host": "127.0.0.1"}, {"Host": "127.0.0.1:1"}, {"Origin": "http://example.com"},
                                     {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}], ids=str)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_another_host_or_origin_is_refused_with_the_token_too(served, headers, method):
    assert served.ask("/stop" if method == "POST" else "/data", method, headers=headers)[0] == 403
    assert served.process.poll() is None


def test_a_stop_needs_the_token_and_a_post(served):
    assert served.ask("/stop", "POST", token="")[0] == 403 and served.ask("/stop", "GET")[0] == 404
    assert served.ask("/stop", "PUT")[0] == 501 and served.process.poll() is None


def test_it_tells_how_it_goes(served):
    def news():
        return json.loads(served.ask("/data")[2])

    first, start = news(), time.monotonic()
    assert first["data"]["phases"][0]["name"] == "shape" and not first["over"]
    while news()["data"]["phases"][0]["steps"] <= first["data"]["phases"][0]["steps"] or news()["model"] <= first["model"]:
        assert time.monotonic() - start < 60
        time.sleep(0.2)
    assert news()["data"]["views"]["iou_mean"] > 0.5, "of how it is now"
    code, headers, body = served.ask("/")
    assert code == 200 and b"x.dressi" in body and headers["Cache-Control"] == "no-store" and "Access-Control-Allow-Origin" not in headers
    assert "connect-src 'self'" in headers["Content-Security-Policy"] and headers["Referrer-Policy"] == "no-referrer"
    assert served.token.encode() not in body, "the page knows it from its address alone"
    assert served.ask("/model")[2][:4] == b"glTF" and len(json.loads(served.ask("/pictures")[2])[1]["images"]) == 2


def test_strange_requests_do_no_harm(served):
    for data in (b"\0\xff\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n", b"GET " + b"/" * 70000 + b" HTTP/1.1\r\n\r\n"):
        with socket.create_connection((served.host, served.port), timeout=10) as s:
            s.sendall(data)
            s.settimeout(15)
            assert b"x.dressi" not in s.recv(4096)
    assert served.ask("/data")[0] == 200


def test_the_buttons_write_a_checkpoint_and_stop_with_results(bundle, tmp_path):
    with Served(bundle, "--checkpoint", tmp_path / "c", "-o", tmp_path / "out.npz") as served:
        assert served.ask("/checkpoint", "POST")[0] == 204
        until(served.process, lambda e: e["event"] == "wrote" and e["what"] == "checkpoint")
        assert (tmp_path / "c").exists() and served.process.poll() is None
        assert served.ask("/stop", "POST")[0] == 204
        code, events, err = rest(served.process)
        steps = events[-1]["metrics"]["phases"]["shape"]["steps"]
        assert code == 130 and err == "" and 50 < steps < 200000
        assert np.load(tmp_path / "out.npz")["shape.step"] == steps


def test_a_port_in_use_is_said(bundle):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = command("run", bundle, "--steps", "1", "--serve", taken.getsockname()[1])
        assert done.returncode == 3 and "give another port" in done.stderr
    done = command("run", bundle, "--steps", "1", "--serve", "70000")
    assert done.returncode == 2 and "is no port" in done.stderr


@pytest.mark.skipif(chromium() is None, reason="no Chromium: the live page is asked, but not seen")
def test_a_browser_shows_it_live_and_its_stop_button_stops(bundle):
    with Served(bundle) as served, Browser(width=480, height=360) as browser:
        browser.open(served.address)
        browser.until("window.dressi && dressi.viewer.drawn && document.querySelectorAll('#sheet img').length")
        shown = "dressi.data.phases[0].steps"
        first, drawn = browser.run(shown), browser.run("dressi.viewer.drawn")
        browser.until(f"{shown} > {first} && dressi.viewer.drawn > {drawn} && document.querySelectorAll('#loss polyline').length")
        assert browser.run("document.querySelector('[data-do=checkpoint]')") is None, "there is no checkpoint file to write"
        browser.run("document.querySelector('[data-do=stop]').click()")
        browser.until("document.querySelector('#subtitle').textContent.includes('ended early')")
        assert served.process.wait(60) == 130
        assert browser.errors == [] and all(r.startswith((f"http://127.0.0.1:{served.port}/", "data:", "blob:", "about:"))
                                            for r in browser.requests)
