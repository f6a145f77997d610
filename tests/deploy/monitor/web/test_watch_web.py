"""From a worker to the browser: source, hub and web server."""

import http.client
import json
import socket
import struct
import time
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from eia_sec.common.errors import EndpointError
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope
from eia_sec.common.transport.bus import Bus
from eia_sec.deploy.monitor.web import hub as hubs
from eia_sec.deploy.monitor.web import server
from eia_sec.deploy.monitor.web.address import bracketed
from eia_sec.deploy.monitor.web.hub import Hub
from eia_sec.deploy.monitor.web.packets import Packet, pack
from eia_sec.deploy.monitor.web.server import FILES, MAX_BROWSERS, WebServer
from eia_sec.deploy.monitor.web.source import Source
from tests.common.protocol.test_view_checks import a_view
from tests.deploy.monitor.web.stage import CONFIG, RUN, flying, until


def header(data):
    (length,) = struct.unpack_from("<I", data)
    return json.loads(data[4 : 4 + length])


def kinds(seat):
    found = []
    while (packet := seat.take(0.0)) is not None:
        found.append(header(packet.data))
    return found


def frames(size=1, count=10):
    return Packet(pack("frames", {}, {}).data + bytes(size), count)


def test_a_browser_that_comes_late_gets_the_recent_past(monkeypatch):
    """It gets the scene, the newest HISTORY_FRAMES frames and the state; what is older is forgotten."""
    monkeypatch.setattr(hubs, "HISTORY_FRAMES", 30)
    hub = Hub()
    hub.begin(pack("scene", {}, {}))
    for number in range(8):
        hub.show(Packet(pack("frames", {"number": number}, {}).data, 10))
    hub.report(pack("state", {}, {}))
    found = kinds(hub.enter(1))
    assert [entry["kind"] for entry in found] == ["scene", "frames", "frames", "frames", "state"]
    assert [entry["number"] for entry in found[1:4]] == [5, 6, 7]
    hub.begin(pack("scene", {}, {}))
    assert [entry["kind"] for entry in kinds(hub.enter(2))] == ["scene", "state"]


def test_a_slow_browser_loses_the_oldest_frames_and_it_is_counted(monkeypatch):
    """What waits for one browser is bounded; only frames are dropped, and others do not notice."""
    monkeypatch.setattr(hubs, "QUEUE_BYTES", 5000)
    hub = Hub()
    slow, quick = hub.enter(2), hub.enter(2)
    hub.begin(pack("scene", {}, {}))
    for _ in range(10):
        hub.show(frames(1000))
        assert [entry["kind"] for entry in kinds(quick)][-1] == "frames"
    left = [entry["kind"] for entry in kinds(slow)]
    assert left[0] == "scene"
    assert slow.dropped == 10 * (10 - left.count("frames")) > 0
    assert quick.dropped == 0
    assert hub.enter(2) is None


def ask(port, path="/", **headers):
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    link.request("GET", path, headers=headers)
    answer = link.getresponse()
    return answer.status, answer.headers, answer.read()


def test_the_page_and_nothing_else_is_served():
    """Every file of the page is there with a policy that lets nothing in from elsewhere; other paths are not."""
    with WebServer(Hub(), "127.0.0.1", 0) as web:
        for path in FILES:
            status, headers, body = ask(web.port, path)
            assert (status, len(body) > 300) == (200, True)
            assert "default-src 'none'" in headers["Content-Security-Policy"]
            assert b"http://" not in body.replace(b"http://www.w3.org", b"")
            assert b"https://" not in body
        for path in ("/../server.py", "/watch.css/..", "/server.py", "/favicon.ico"):
            assert ask(web.port, path)[0] == 404


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1:1", "localhost.evil.example:{port}"]
)
def test_other_hosts_names_are_refused(host):
    """A name that somebody has pointed at this machine does not reach the page."""
    with WebServer(Hub(), "127.0.0.1", 0) as web:
        assert ask(web.port, Host=host.format(port=web.port))[0] == 421
        assert ask(web.port, Host=f"localhost:{web.port}")[0] == 200
        assert web.refused == 1


def test_the_address_that_was_asked_for_is_answered():
    """Whoever listens at another of this machine's own addresses reaches the page there."""
    with WebServer(Hub(), "127.0.0.2", 0) as web:
        connection = http.client.HTTPConnection("127.0.0.2", web.port, timeout=10.0)
        connection.request("GET", "/")
        assert connection.getresponse().status == 200
        connection.close()


OWN = "Host: 127.0.0.1:{port}"
UPGRADE = (
    *("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"),
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
)


@pytest.mark.parametrize(
    ("path", "lines"),
    [
        ("/", (OWN, OWN)),
        ("/", (OWN, "Host: evil.example")),
        ("/", (OWN, "Origin: a", "Origin: b")),
        ("/stream", (OWN, *UPGRADE, "Origin: http://127.0.0.1:{port}", "Origin: http://127.0.0.1:{port}")),
        ("/stream", (OWN, *UPGRADE, "Origin: http://127.0.0.1:{port}", "Origin: http://evil.example")),
        ("/stream", (OWN, OWN, *UPGRADE, "Origin: http://127.0.0.1:{port}")),
        ("/stream", (OWN, *UPGRADE, UPGRADE[3], "Origin: http://127.0.0.1:{port}")),
        ("/stream", (OWN, *UPGRADE, UPGRADE[2], "Origin: http://127.0.0.1:{port}")),
        ("/stream", (OWN, "Origin: http://127.0.0.1:{port}")),
        ("/", ()),
    ],
)
def test_a_request_with_odd_headers_is_the_senders_mistake(path, lines):
    """Headers that come twice, or are missing, are answered with a 4xx and no traceback, and the next one is served."""
    with WebServer(Hub(), "127.0.0.1", 0) as web:
        head = "\r\n".join((f"GET {path} HTTP/1.1", *lines, "", "")).format(port=web.port)
        with socket.create_connection(("127.0.0.1", web.port), timeout=30) as link:
            link.sendall(head.encode())
            answer = link.makefile("rb").readline().decode()
        assert 400 <= int(answer.split()[1]) < 500, answer
        assert ask(web.port)[0] == 200


@pytest.mark.parametrize(
    "origin", [None, "http://evil.example", "null", "https://127.0.0.1:{port}", "http://localhost:1"]
)
def test_other_sites_pages_do_not_get_the_stream(origin):
    """A WebSocket is refused unless the page that opens it is this server's own."""
    hub = Hub()
    hub.begin(pack("scene", {}, {}))
    with WebServer(hub, "127.0.0.1", 0) as web:
        url = f"ws://127.0.0.1:{web.port}/stream"
        with pytest.raises(InvalidStatus) as refusal, connect(url, origin=origin and origin.format(port=web.port)):
            pass
        assert refusal.value.response.status_code == 403
        with connect(url, origin=f"http://127.0.0.1:{web.port}") as browser:
            assert header(browser.recv(timeout=30))["kind"] == "scene"


def test_there_is_room_for_so_many_browsers():
    """More than MAX_BROWSERS are turned away, and a place that is given back is free again."""
    hub = Hub()
    with WebServer(hub, "127.0.0.1", 0) as web:
        url, own = f"ws://127.0.0.1:{web.port}/stream", f"http://127.0.0.1:{web.port}"
        with ExitStack() as browsers:
            for _ in range(MAX_BROWSERS):
                browsers.enter_context(connect(url, origin=own))
            until(lambda: hub.seats == MAX_BROWSERS, "a seat for each")
            with pytest.raises(InvalidStatus), connect(url, origin=own):
                pass
        until(lambda: hub.seats == 0, "seats given back")


def test_a_port_that_is_taken_is_a_users_mistake():
    """The second server on a port says so in a sentence."""
    with WebServer(Hub(), "127.0.0.1", 0) as web, pytest.raises(EndpointError, match="taken"):
        WebServer(Hub(), "127.0.0.1", web.port)


def test_a_worker_publishes_only_while_somebody_looks():
    """Frames come when a browser is there, two watchers see the same worker, and it ends with the last."""
    with flying() as (endpoint, view_service):
        pairs = []
        for _ in range(2):
            bus, hub = Bus.connect(endpoint, "control", wait=30.0), Hub()
            pairs.append((bus, hub, Source(bus, RUN, None, hub)))
        for _, _, source in pairs:
            source.tend(False)
        assert (view_service.watchers, view_service.shown) == (0, 0)
        seats = [hub.enter(1) for _, hub, _ in pairs]

        def tend():
            for _, hub, source in pairs:
                source.tend(hub.seats > 0)
            return view_service.watchers == 2 and view_service.shown > 90

        until(tend, "frames for two watchers")
        for seat in seats:
            found = [entry for entry in kinds(seat) if entry["kind"] in ("scene", "frames")]
            assert found[0]["kind"] == "scene"
            assert found[0]["worker"] == "w"
            views = [entry for entry in found if entry["kind"] == "frames"]
            assert all(
                after["first"] > before["first"]
                for before, after in pairwise(views)
                if before["episode"] == after["episode"]
            )
            assert views
        for _, _, source in pairs:
            source.tend(False)
            assert source.lost == source.malformed == 0
        until(lambda: view_service.watchers == 0, "the end of the watching")
        shown = view_service.shown
        until(lambda: view_service._steps() > shown + 300, "more steps")
        assert view_service.shown == shown
        for bus, _, _ in pairs:
            bus.close()


def test_what_is_malformed_or_missing_is_counted_and_not_shown():
    """A view of another farm, under another name, or spoilt, is not drawn; gaps in the numbers are lost messages."""
    with flying() as (endpoint, _), Bus.connect(endpoint, "control", wait=30.0) as bus:
        hub = Hub()
        source, seat = Source(bus, RUN, "w", hub), hub.enter(1)

        def shown():
            source.tend(True)
            return any(entry["kind"] == "frames" for entry in kinds(seat))

        until(shown, "a frame")
        publisher = bus.publish(keys.VIEW.key(RUN, worker="w"))
        before = source.lost
        whole = a_view(2)
        for payload, name, sequence in (
            (whole.encode()[:-1], "w", 1),
            (replace(whole, aoi=whole.aoi[:, 1:].copy()).encode(), "w", 2),
            (whole.encode(), "somebody", 3),
            (whole.encode(), "w", 4),
            (whole.encode(), "w", 9),
        ):
            publisher.put(payload, Envelope("rollout", name, 99, sequence).encode())
        until(lambda: source.tend(True) or (source.malformed == 3 and source.lost == before + 4), "the counts")
        assert CONFIG.farm.world.sensors == 30


def test_it_says_whom_it_waits_for_and_takes_whoever_lives():
    """A worker that was named and is not there is waited for by name; without a name the first that lives is taken."""
    with flying("other") as (endpoint, _), Bus.connect(endpoint, "control", wait=30.0) as bus:
        hub = Hub()
        source, seat = Source(bus, RUN, "w", hub), hub.enter(1)

        def said(sentence):
            source.tend(True)
            return any(entry["kind"] == "state" and sentence in entry["sentence"] for entry in kinds(seat))

        until(lambda: said(f"Waiting for worker w of run {RUN}"), "the sentence")
        anybody = Source(bus, RUN, None, Hub())
        until(lambda: anybody.tend(True) or anybody.worker, "one that lives")
        assert (anybody.worker, source.worker) == ("other", "w")


def test_a_browser_that_reads_nothing_is_disconnected(monkeypatch):
    """Its seat is free again, and the server can be stopped."""
    monkeypatch.setattr(server, "SEND_SECONDS", 0.5)
    hub = Hub()
    with WebServer(hub, "127.0.0.1", 0) as web:
        own = f"http://127.0.0.1:{web.port}"
        head = "\r\n".join(("GET /stream HTTP/1.1", OWN, *UPGRADE, f"Origin: {own}", "", "")).format(port=web.port)
        with socket.create_connection(("127.0.0.1", web.port), timeout=30) as link:
            link.sendall(head.encode())
            until(lambda: hub.seats == 1, "a seat")
            for _ in range(200):
                hub.begin(pack("scene", {}, {"much": np.zeros(2**18, np.float32)}))
                if hub.seats == 0:
                    break
                time.sleep(0.02)
            assert until(lambda: hub.seats == 0, "the seat given back")


def test_connections_that_ask_for_nothing_do_not_end_the_server(monkeypatch):
    """More than MAX_CONNECTIONS are closed at once and counted; when the others have gone, the page is served."""
    monkeypatch.setattr(server, "MAX_CONNECTIONS", 4)
    with WebServer(Hub(), "127.0.0.1", 0) as web:
        assert not web.failed
        with ExitStack() as idle:
            for _ in range(12):
                idle.enter_context(socket.create_connection(("127.0.0.1", web.port), timeout=30))
            until(lambda: web.refused >= 8, "connections turned away")
        until(lambda: len(web._server.handler_threads) == 0, "the others gone")
        assert ask(web.port)[0] == 200
    assert web.failed


def test_the_page_is_served_over_ipv6():
    """An address with colons stands in brackets in a URL."""
    try:
        web = WebServer(Hub(), "::1", 0)
    except EndpointError:
        pytest.skip("this machine has no IPv6")
    with web:
        link = http.client.HTTPConnection("::1", web.port, timeout=30)
        link.request("GET", "/", headers={"Host": f"[::1]:{web.port}"})
        assert link.getresponse().status == 200
        link.close()
    assert [bracketed(host) for host in ("::1", "[::1]", "127.0.0.1")] == ["[::1]", "[::1]", "127.0.0.1"]


@pytest.mark.parametrize(("port", "answered"), [(80, True), (8080, False)])
def test_browsers_leave_the_usual_port_out(port, answered):
    """On port 80 a Host and an Origin without a port are this server's own."""
    with WebServer(Hub(), "127.0.0.1", 0) as web:
        web.port = port
        found = web._objection("/stream", ["127.0.0.1"], ["http://127.0.0.1"])
    assert (found is None) == answered


def test_names_that_are_no_workers_are_not_watched():
    """A living token with an odd name is counted, and the worker beside it is watched."""
    hub = Hub()
    alive = iter([SimpleNamespace(key=f"a/live/rollout/{name}", present=True) for name in ("!x", "good-0")])
    views = SimpleNamespace(drain=lambda: alive, missed=0)
    bus = SimpleNamespace(
        watch=lambda *a: views, subscribe=lambda *a: views, ask=lambda *a: None, living=lambda key: False
    )
    source = Source(bus, RUN, None, hub)
    source._look_around()
    source._choose()
    assert (source.worker, source.malformed) == ("good-0", 1)


def test_browsers_that_hang_up_keep_no_seat(capfd):
    """After sixty that open the stream and hang up at once, all seats are free, and nothing was printed."""
    hub = Hub()
    with WebServer(hub, "127.0.0.1", 0) as web:
        for number in range(60):
            link = socket.create_connection(("127.0.0.1", web.port), timeout=10)
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", number % 2, 0))
            link.sendall(
                f"GET /stream HTTP/1.1\r\nHost: 127.0.0.1:{web.port}\r\nOrigin: http://127.0.0.1:{web.port}\r\n"
                "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
                "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
            )
            if number % 3 == 0:
                link.recv(100)
            link.close()
            time.sleep(0.01)
        deadline = time.monotonic() + 20.0
        while hub.seats and time.monotonic() < deadline:
            time.sleep(0.05)
        assert hub.seats == 0
    assert capfd.readouterr().err == ""


def test_a_seat_is_given_back_when_the_socket_is_already_closed():
    """A browser that is gone before its thread first uses the socket costs nothing."""
    hub = Hub()
    with WebServer(hub, "127.0.0.1", 0) as web:
        gone = socket.socket()
        gone.close()
        web._feed(SimpleNamespace(socket=gone, close_code=None))
    assert hub.seats == 0
