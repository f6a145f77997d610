"""Strangers who hold connections half open: members stay served, newcomers get in, an alarm says what waits."""

import os
import resource
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from eia_sec.common.protocol import keys
from eia_sec.common.transport.admission import MOST_WAITING, Admission, AdmissionSource, admission
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.credentials import load
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.common.transport.zenoh_config import ACCEPT_MS
from tests.system.fleet import until

KEY = keys.TRANSITION.key("run", worker="a")
HELLO = b"\x16\x03\x01\x02\x00"
"""The first bytes of a TLS handshake that never goes on."""


def places(keys_folder: Path, protocol: str) -> tuple[Endpoint, Endpoint]:
    """Return one place twice, as its listener and a worker see it."""
    place = free_endpoint()
    if protocol == "tcp":
        return place, place
    names = ("learner.learner", "rollout.a")
    listener, worker = (replace(place, protocol="tls", credentials=load(keys_folder / name)) for name in names)
    return listener, worker


@contextmanager
def half_open(place: Endpoint, count: int) -> Iterator[None]:
    """Hold so many connections that say nothing further."""
    with ExitStack() as stack:
        for _ in range(count):
            stranger = stack.enter_context(socket.create_connection((place.host, place.port), timeout=5.0))
            if place.credentials is not None:
                stranger.sendall(HELLO)
        yield


@contextmanager
def answering(bus: Bus) -> Iterator[None]:
    """Answer requests from a thread until the bus is closed."""
    server = bus.serve(KEY, 64)

    def answer() -> None:
        for incoming in server:
            incoming.reply(b"answer")

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        yield
    finally:
        bus.close()
        thread.join(10.0)


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_half_open_connections_keep_nobody_out(keys_folder, protocol):
    """With 150 of them held, longer than a connection may take, a member is served and a newcomer gets in at once."""
    listener, worker = places(keys_folder, protocol)
    with Bus.listen(listener, "control") as bus, answering(bus), Bus.connect(worker, "control", wait=10.0) as member:
        # A request that comes before the server's declaration finds nobody.
        until(lambda: member.ask(KEY, b"request", 5.0) == b"answer", "an answer")
        with half_open(listener, 150):
            end = time.monotonic() + ACCEPT_MS / 1000.0 + 1.0
            while time.monotonic() < end:
                assert member.ask(KEY, b"request", 2.0) == b"answer"
                time.sleep(0.02)
            Bus.connect(worker, "control", wait=5.0).close()  # Zenoh's defaults refused newcomers for 10 s
        assert member.ask(KEY, b"request", 5.0) == b"answer"


def test_what_hung_up_is_seen_and_named(keys_folder):
    """Connections in the line are counted while they wait, an alarm says how long that takes, members stay served."""
    listener, worker = places(keys_folder, "tls")
    with Bus.listen(listener, "control") as bus, answering(bus), Bus.connect(worker, "control", wait=10.0) as member:
        until(lambda: member.ask(KEY, b"request", 5.0) == b"answer", "an answer")
        before = admission(listener)
        with half_open(listener, 2 * MOST_WAITING):
            time.sleep(0.5)
            held = admission(listener)
        time.sleep(0.3)
        gone = admission(listener)
        assert member.ask(KEY, b"request", 2.0) == b"answer"
    assert (before.waiting, held.waiting) == (0, 0)
    assert held.descriptors >= before.descriptors + 2 * MOST_WAITING
    assert gone.waiting > MOST_WAITING
    assert f"{gone.waiting} connections were closed by their peers" in gone.alarms()[0]
    assert held.alarms() == []


def test_a_report_looks_once(monkeypatch):
    """The alarms of a report are of the same look as its metrics, and before the first there are none."""
    looks = iter([Admission(900, 1000, 3), Admission(1, 1000, 0)])
    monkeypatch.setattr("eia_sec.common.transport.admission.admission", lambda endpoint: next(looks))
    source = AdmissionSource(free_endpoint())
    assert source.alarms() == []
    assert source.metrics() == {"descriptors": 900, "waiting_connections": 3}
    assert len(source.alarms()) == len(source.alarms()) == 1
    assert source.metrics()["descriptors"] == 1
    assert source.alarms() == []


@pytest.mark.parametrize(("descriptors", "alarms"), [(500, 0), (513, 1)])
def test_too_many_descriptors_are_an_alarm(descriptors, alarms):
    """From half of what a process may have on."""
    assert len(Admission(descriptors, 1024, MOST_WAITING).alarms()) == alarms


def test_no_descriptor_left_is_the_loudest_alarm():
    """Where even the list of descriptors cannot be opened, all are in use."""
    held, place = [], free_endpoint()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(soft, 256), hard))
    try:
        with suppress(OSError):
            while True:
                held.append(os.open(os.devnull, os.O_RDONLY))
        found = admission(place)
    finally:
        for descriptor in held:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert found.descriptors == found.limit == min(soft, 256)
    assert "descriptors are open; when none are left, nobody can connect" in found.alarms()[0]
