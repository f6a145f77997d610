"""No certificate, another authority's, an expired one, the wrong name, plaintext: no link, no message, one sentence."""

import datetime
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from eia_sec.common.errors import CredentialsError, EndpointError
from eia_sec.common.protocol import keys
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.credentials import Credentials, Identity
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.common.transport.handshake import complaint
from eia_sec.common.transport.zenoh_config import connecting, listening, routing
from eia_sec.deploy.commands.training import elite, rollout
from eia_sec.deploy.security import authority
from tests.security.conftest import YEAR, make_authority
from tests.security.probe import open_session

METRIC = keys.METRIC.key("run", role="rollout", name="a")


def unchecked(folder: Path) -> Credentials:
    """Return a folder's credentials as somebody would use them who does not check."""
    members = (Identity("rollout", "a"), Identity("rollout", "brief"))
    return Credentials(folder, Identity.parse(folder.name), datetime.datetime.now(datetime.UTC), (), members)


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory, other_folder: Path) -> Path:
    """An authority with certificates that are wrong in one way each."""
    folder = make_authority(tmp_path_factory.mktemp("bad") / "keys")
    past = datetime.timedelta(minutes=-1)
    authority.issue(folder, Identity.parse("rollout.old"), [], past)
    authority.issue(folder, Identity.parse("router.old"), ["127.0.0.1"], past)
    authority.issue(folder, Identity.parse("router.elsewhere"), ["farm.example", "192.0.2.1"], YEAR)
    shutil.copytree(other_folder / "rollout.a", folder / "rollout.foreign")
    shutil.copy(folder / "ca.pem", folder / "rollout.foreign" / "ca.pem")
    return folder


def endpoints(listener: Path | None, client: Path | None) -> tuple[Endpoint, Endpoint]:
    """Return one place twice, with each side's credentials; None is plaintext."""
    place = free_endpoint()
    listening, connecting = (
        place if folder is None else replace(place, protocol="tls", credentials=unchecked(folder))
        for folder in (listener, client)
    )
    return listening, connecting


def attempt(listener: Endpoint, client: Endpoint, patience: float = 10.0) -> tuple[str, int]:
    """Return the message that a client gets, and how many messages the listener gets from it."""
    with Bus.listen(listener, "control") as bus:
        subscription = bus.subscribe(METRIC, 16)
        message = ""
        try:
            with Bus.connect(client, "control", wait=patience) as link:
                time.sleep(0.3)
                link.publish(METRIC).put(b"message")
                time.sleep(0.5)
        except EndpointError as error:
            message = str(error)
        return message, len(list(subscription.drain()))


def test_a_good_certificate_delivers(bad):
    """With a certificate of the authority a message arrives; without this the refusals below would prove nothing."""
    assert attempt(*endpoints(bad / "learner.learner", bad / "rollout.a")) == ("", 1)


@contextmanager
def answering(answers: list[bytes]) -> Iterator[tuple[Endpoint, list[float]]]:
    """Take connections one after another, say what the next answer is, and hang up; yield when each one came."""
    came: list[float] = []
    place = free_endpoint()
    with socket.create_server((place.host, place.port)) as server:

        def serve() -> None:
            with suppress(OSError):
                while True:
                    link, _ = server.accept()
                    came.append(time.monotonic())
                    with link:
                        link.settimeout(2.0)
                        with suppress(OSError):
                            link.recv(4096)
                            link.sendall(answers[min(len(came), len(answers)) - 1])

        thread = threading.Thread(target=serve)
        thread.start()
        yield place, came
        server.shutdown(socket.SHUT_RDWR)
        thread.join(10.0)


def test_a_listener_that_hangs_up_is_tried_again(bad):
    """A router that is only starting may close what it has just accepted: whoever has time goes on trying."""
    with answering([b""]) as (place, came):
        client = replace(place, protocol="tls", credentials=unchecked(bad / "rollout.a"))
        assert complaint(client, "control") is None
        with pytest.raises(EndpointError, match="accepts connections but opens no session"):
            Bus.connect(client, "control", wait=3.0).close()
        assert len(came) > 2
        assert came[-1] - came[0] > 2.0


def test_a_listener_that_speaks_something_else_is_named_at_once(bad):
    """What is no TLS at all does not become TLS by waiting."""
    with answering([b"HTTP/1.1 400 Bad Request\r\n\r\n"]) as (place, _):
        client = replace(place, protocol="tls", credentials=unchecked(bad / "rollout.a"))
        assert "the TLS handshake with the listener at" in (complaint(client, "control") or "")


@pytest.mark.parametrize(
    ("listener", "client", "sentence"),
    [
        ("learner.learner", "rollout.foreign", "did not accept rollout.foreign .*another authority signed"),
        ("learner.learner", "rollout.old", "did not accept rollout.old .*has expired by the listener's clock"),
        ("learner.learner", None, "speaks TLS; this process needs --tls"),
        ("router.old", "rollout.a", "is not accepted: its certificate has expired"),
        ("router.elsewhere", "rollout.a", "is not accepted: its certificate is not for this address"),
        ("rollout.b", "rollout.a", "its certificate belongs to a process that may only connect"),
    ],
)
def test_a_wrong_certificate_delivers_nothing_and_says_why(bad, listener, client, sentence):
    """One sentence long before a minute of patience is over, and no message."""
    started = time.monotonic()
    message, messages = attempt(*endpoints(bad / listener, bad / client if client else None), patience=60.0)
    assert messages == 0
    assert time.monotonic() - started < 30.0
    assert re.search(sentence, message), message


def test_a_listener_without_tls_gets_nothing(bad):
    """A process with a certificate does not speak to a plaintext listener, and says what it found."""
    message, messages = attempt(*endpoints(None, bad / "rollout.a"), patience=0.1)
    assert (messages, "or listens without TLS" in message) == (0, True)


def test_no_certificate_is_not_accepted(bad):
    """A client that knows the authority and shows no certificate gets no link."""
    listener, client = endpoints(bad / "learner.learner", bad / "rollout.a")
    values = connecting(client, "control")
    known = values["transport/link/tls"]["root_ca_certificate"]
    values["transport/link/tls"] = {"root_ca_certificate": known, "enable_mtls": False}
    with Bus.listen(listener, "control") as bus:
        subscription = bus.subscribe(METRIC, 16)
        with pytest.raises(Exception, match="Unable to connect"):
            open_session(values)
        assert list(subscription.drain()) == []


def test_a_message_over_the_limit_is_dropped_where_it_arrives(monkeypatch):
    """It never reaches the process, its sender gets no answer, and what it sends within the limit is still served."""
    place = free_endpoint()
    monkeypatch.setattr("eia_sec.common.transport.zenoh_config.MAX_FRAME", 2**20)
    with Bus.listen(place, "bulk") as bus:
        server = bus.serve("a/x", 8)
        monkeypatch.undo()
        with Bus.connect(place, "bulk", wait=10.0) as sender:
            thread = threading.Thread(target=lambda: [incoming.reply(incoming.payload[:9]) for incoming in server])
            thread.start()
            try:
                sizes = (9, 2**20 + 1, 2**21, 10)
                deadline = time.monotonic() + 30.0
                while sender.ask("a/x", b"x", 1.0) is None and time.monotonic() < deadline:
                    time.sleep(0.1)
                answers = [sender.ask("a/x", bytes(size), 1.0 if size > 2**20 else 30.0) for size in sizes]
            finally:
                bus.close()
                thread.join()
    assert answers == [bytes(9), None, None, bytes(9)]


@pytest.mark.nightly
def test_a_link_ends_with_its_certificate(bad):
    """A link that was made with a valid certificate is closed when that ends."""
    folder = authority.issue(bad, Identity.parse("rollout.brief"), [], datetime.timedelta(seconds=8))
    listener, client = endpoints(bad / "learner.learner", folder)
    with Bus.listen(listener, "control") as bus:
        watch = bus.watch(keys.LIVE.pattern("run"), 16)
        with Bus.connect(client, "control", wait=3.0) as link:
            token = link.announce(keys.LIVE.key("run", role="rollout", name="brief"))
            seen: list[bool] = []
            deadline = time.monotonic() + 40.0
            while seen != [True, False] and time.monotonic() < deadline:
                seen += [sample.present for sample in watch.drain()]
                time.sleep(0.05)
            assert (seen, token is None) == ([True, False], False)


def eia_sec(*arguments: str) -> tuple[int, list[str]]:
    """Return exit code and complaints of a command."""
    done = subprocess.run(
        [sys.executable, "-m", "eia_sec.deploy.cli", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    return done.returncode, done.stderr.splitlines()


@pytest.mark.parametrize(
    ("command", "arguments", "wanted"),
    [(rollout.command, ("--name", "b"), "rollout.b"), (elite.command, (), "elite.coordinator")],
)
def test_commands_refuse_somebody_elses_certificate(keys_folder, command, arguments, wanted):
    """A command with another process's certificate ends before anything is sent, with one sentence."""
    with pytest.raises(CredentialsError, match=f"belongs to rollout.a, but this process is {wanted}"):
        command([*arguments, "--tls", str(keys_folder / "rollout.a")])


def test_a_worker_of_another_authority_ends_with_the_reason(keys_folder, other_folder):
    """The command line says in one sentence why there is no link, with exit code 2."""
    endpoint = Endpoint.parse(str(free_endpoint()), keys_folder / "learner.learner")
    with Bus.listen(endpoint, "control"):
        code, lines = eia_sec("rollout", "--connect", str(endpoint), "--tls", str(other_folder / "rollout.a"))
    assert (code, "another authority signed its certificate" in lines[-1]) == (2, True)


def test_shared_memory_is_asked_for_and_on_the_bulk_lane_alone():
    """What is lost in silence there is transitions, which are acknowledged, and never a parameter or a command."""
    quiet = Endpoint.parse("tcp/127.0.0.1:7447")
    sharing = Endpoint.parse("tcp/127.0.0.1:7447", shared_memory=True)
    name = "transport/shared_memory/enabled"
    assert not any(connecting(quiet, lane)[name] or listening(quiet, lane)[name] for lane in ("control", "bulk"))
    assert not connecting(sharing, "control")[name]
    assert not listening(sharing, "control")[name]
    assert connecting(sharing, "bulk")[name]
    assert listening(sharing, "bulk")[name]
    assert routing(sharing)[name]
    assert not routing(quiet)[name]


def test_defaults_are_loopback_and_silent():
    """Sessions listen nowhere by default, find nobody, are found by nobody, and bound what they take in."""
    values = connecting(Endpoint.parse("tcp/127.0.0.1:7447"), "bulk")
    assert values["listen/endpoints"] == []
    assert not values["scouting/multicast/enabled"]
    assert not values["scouting/gossip/enabled"]
    assert 0 < values["transport/link/rx/max_message_size"] <= 2**28
