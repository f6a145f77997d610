"""Whom the page shows, and what it says while no frames come: a bus by hand, and a clock of the test's."""

from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest
from websockets.sync.client import connect

from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.config.files import to_toml
from eia_sec.common.errors import BusError
from eia_sec.common.protocol.messages import Envelope, WatchTerms
from eia_sec.deploy.monitor.web import source as sources
from eia_sec.deploy.monitor.web.hub import Hub
from eia_sec.deploy.monitor.web.server import WebServer
from eia_sec.deploy.monitor.web.source import Source
from tests.common.protocol.test_view_checks import TEAM, a_view, some_steps
from tests.deploy.monitor.web.stage import CONFIG, RUN, until
from tests.deploy.monitor.web.test_watch_web import header, kinds

FARM = WatchTerms(to_toml(CONFIG), ("a", "b"), 4.0, 25.0)
OTHER = WatchTerms(to_toml(RunConfig(env=EnvConfig("some:where"))), (), 4.0, 25.0, ("r0", "r1", "k"), TEAM.to_dict())


class AnyBus:
    """What `Source` uses of a bus; the test says who lives, what is answered and what arrives."""

    credentials = None

    def __init__(self, terms=FARM):
        self.tokens, self.views = deque(), deque()
        self.terms, self.asked, self.subscribed = terms, [], []
        self.answers = True

    def live(self, role, name, present=True):
        self.tokens.append(SimpleNamespace(key=f"x/{RUN}/live/{role}/{name}", present=present))

    def show(self, message, sequence):
        self.views.append(
            SimpleNamespace(payload=message.encode(), attachment=Envelope("rollout", "w", 1, sequence).encode())
        )

    def watch(self, key, capacity):
        return SimpleNamespace(drain=lambda: self._drained(self.tokens))

    def subscribe(self, key, capacity):
        self.subscribed.append(key)
        return SimpleNamespace(drain=lambda: self._drained(self.views))

    def _drained(self, held):
        while held:
            yield held.popleft()

    def living(self, key):
        return []

    def ask(self, key, payload, timeout):
        self.asked.append(key)

    def asking(self, key, payload, timeout):
        while not self.answers:
            yield 0.0
        if isinstance(self.answers, str):
            raise BusError(self.answers)
        yield 0.0
        return self.terms.encode()


@pytest.fixture
def scene(monkeypatch):
    """Return a bus, a source that watches on it, its clock, and what a browser was told last."""
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(sources, "time", SimpleNamespace(monotonic=lambda: clock.now, time_ns=lambda: 1))

    def begin(terms=FARM, worker=None):
        bus, hub = AnyBus(terms), Hub()
        source, seat = Source(bus, RUN, worker, hub), hub.enter(1)
        got = []

        def tend(seconds=1.1, times=1):
            for _ in range(times):
                clock.now += seconds
                source.tend(True)
            got.extend(kinds(seat))
            return next(entry for entry in reversed(got) if entry["kind"] == "state")

        return bus, source, hub, tend, got

    return begin


def test_a_busy_worker_is_said_to_be_busy_and_since_when(scene):
    """Its answer counts whenever it comes; what it has shown stays, and nothing is said any more."""
    bus, _, _, tend, got = scene()
    bus.live("rollout", "w")
    bus.live("learner", "learner")
    bus.answers = False
    assert tend(times=4)["sentence"] == "Worker w is busy; it has shown nothing yet."
    bus.answers = True
    assert tend(times=2)["sentence"] == ""
    assert [entry["kind"] for entry in got if entry["kind"] != "state"] == ["scene"]
    message = a_view()
    bus.show(type(message)(**{**vars(message), "parts": np.zeros((3, 3, 2), np.float32)}), 1)
    tend(0.1)
    assert got[-1]["kind"] == "frames"
    bus.answers = False
    state = tend(times=12)
    assert state["sentence"] == "Worker w is busy; last frame 13 s ago."
    assert not state["wrong"]


def test_a_run_that_has_ended_is_said_to_have_ended(scene):
    """Before it began nobody is there; with its learner alone a worker is waited for; after both it has ended."""
    bus, _, _, tend, _ = scene()
    assert tend()["sentence"] == f"Waiting for run {RUN}: none of it is there."
    bus.live("learner", "learner")
    assert tend()["sentence"] == f"Waiting for a worker of run {RUN}."
    bus.live("rollout", "w")
    assert tend(times=3)["sentence"] == ""
    bus.live("rollout", "w", present=False)
    assert tend()["sentence"] == f"Waiting for a worker of run {RUN}."
    bus.live("learner", "learner", present=False)
    assert tend()["sentence"] == f"Run {RUN} has ended."
    bus.live("rollout", "w")
    assert tend(times=3)["sentence"] == ""


def test_a_flight_node_is_called_one(scene):
    """It is shown like a worker, by its own frames alone: those of a worker of its name are not drawn."""
    bus, source, _, tend, got = scene()
    bus.live("flight", "w")
    bus.answers = False
    assert tend(times=4)["sentence"] == "Flight node w is busy; it has shown nothing yet."
    bus.answers = True
    assert tend(times=2)["workers"] == ["w"]
    bus.show(a_view(), 1)
    tend(0.1)
    assert (source.malformed, [entry["kind"] for entry in got].count("frames")) == (1, 0)


def test_what_is_wrong_is_marked(scene):
    """A refusal is a fault, unlike waiting."""
    bus, _, _, tend, _ = scene()
    bus.live("rollout", "w")
    bus.answers = "16 watchers are watching already."
    state = tend()
    assert state["sentence"] == "Worker w: 16 watchers are watching already."
    assert state["wrong"]


def test_a_browser_chooses_among_the_workers(scene):
    """The first is shown, in numbers' order all are offered; another one is shown when a browser asks for it."""
    bus, source, hub, tend, got = scene()
    for name in ("10", "9", "w"):
        bus.live("rollout", name)
    state = tend(times=3)
    assert (state["workers"], state["worker"]) == (["9", "w", "10"], "9")
    hub.wanted = "nobody"
    assert tend(times=3)["worker"] == "9"
    bus.live("rollout", "nobody")
    assert tend(times=3)["worker"] == "9"  # it was not there when it was asked for
    bus.live("rollout", "nobody", present=False)
    hub.wanted = "w"
    assert tend(times=3)["worker"] == "w"
    assert bus.asked == [f"eia-sec/v5/{RUN}/watch/9"]  # which may stop now
    assert [entry["worker"] for entry in got if entry["kind"] == "scene"] == ["9", "w"]
    bus.live("rollout", "w", present=False)
    assert tend(times=3)["sentence"] == f"Waiting for worker w of run {RUN}."
    assert source.worker == "w"


def test_any_environment_is_shown(scene):
    """Its agents are named, its steps passed on with their pictures, and what does not fit is counted."""
    bus, source, _, tend, got = scene(OTHER)
    bus.live("rollout", "w")
    tend(times=3)
    (shown,) = [entry for entry in got if entry["kind"] == "scene"]
    assert (shown["title"], shown["agents"]) == ("some:where", ["r0", "r1", "k"])
    assert [(kind["name"], kind["count"], kind["choices"]) for kind in shown["types"]] == [
        ("runner", 2, []),
        ("keeper", 1, [5]),
    ]
    message = some_steps()
    bus.show(message, 1)
    bus.show(a_view(), 2)
    bus.show(type(message)(**{**vars(message), "reward": np.zeros((3, 4), np.float32)}), 3)
    tend()
    (frames,) = [entry for entry in got if entry["kind"] == "frames"]
    arrays = {name: shape for name, _, shape, _ in frames["arrays"]}
    assert (arrays["parts"], arrays["action"], arrays["pictures"]) == ([3, 3, 1], [3, 5], [len(message.pictures)])
    assert source.malformed == 2


@pytest.mark.parametrize("agents", [("a", "b"), ("a", "b", "x" * 65)])
def test_an_answer_that_cannot_be_right_is_refused(scene, agents):
    """There is one name for each agent, and none is long."""
    terms = WatchTerms(OTHER.toml, (), 4.0, 25.0, agents, TEAM.to_dict())
    bus, _, _, tend, _ = scene(terms)
    bus.live("rollout", "w")
    state = tend(times=3)
    assert "agents' names" in state["sentence"]
    assert state["wrong"]


def test_a_browsers_choice_reaches_the_source():
    """A name is noted; whatever else a browser sends is refused, and the stream goes on."""
    hub = Hub()
    with WebServer(hub, "127.0.0.1", 0) as web:
        own = f"http://127.0.0.1:{web.port}"
        with connect(f"{own.replace('http', 'ws')}/stream", origin=own, open_timeout=30) as browser:
            for said in ("a/b", b"w", ""):
                browser.send(said)
            until(lambda: web.refused == 3, "the refusals")
            assert hub.wanted is None
            browser.send("w-1")
            until(lambda: hub.wanted == "w-1", "the choice")
            hub.begin(sources.packets.pack("scene", {}, {}))
            assert header(browser.recv(timeout=30))["kind"] == "scene"
