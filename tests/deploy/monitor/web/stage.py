"""A worker that shows a small farm, without a learner: by hand with a clock of the test's, or over a real bus."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any

import numpy as np

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import BatteryConfig, EnvConfig, FarmConfig, RunConfig, StressConfig, WorldConfig
from eia_sec.common.config.farm import FailureConfig
from eia_sec.common.config.files import to_toml
from eia_sec.common.config.run import RolloutConfig
from eia_sec.common.protocol.messages import Envelope, ViewMessage, WatchRequest
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.rollout.envs.registry import environment_spec
from eia_sec.rollout.worker.collector import Collector
from eia_sec.rollout.worker.view_service import ViewService
from research.pages import pictures

RUN = "watched"
SECONDS = 60.0
CONFIG = RunConfig(
    farm=FarmConfig(
        world=WorldConfig(
            communication_uavs=1,
            monitoring_uavs=2,
            collection_uavs=2,
            field_x=100.0,
            field_y=80.0,
            sensors=30,
            sensor_spacing=5.0,
            plots_x=5,
            plots_y=4,
            sensor_cycles=(4, 5, 6),
            vdf_cycle=3,
            steps=40,
        )
    ),
    rollout=RolloutConfig(environments=2, chunk_steps=10, train_farms=3),
)
AREA = ((60.0, 50.0), (95.0, 50.0), (95.0, 75.0), (60.0, 75.0))
"""An area of faster growth, m."""
CONDITIONS = replace(
    CONFIG,
    farm=replace(
        CONFIG.farm,
        stress=StressConfig(patches=4, areas=((2, AREA),)),
        battery=BatteryConfig(capacity=8_000.0, stations=2),
        failures=FailureConfig(at="collection 1 at 5"),
        relay=replace(CONFIG.farm.relay, require_link=True, link_range=40.0),
    ),
)
"""The same farm with all that few farms have: links that count, batteries, a UAV that fails, and stress."""
CHAINED = replace(
    CONFIG,
    farm=replace(
        CONFIG.farm,
        world=replace(CONFIG.farm.world, communication_uavs=3),
        relay=replace(CONFIG.farm.relay, require_link=True, link_range=40.0, base="south", hop_range=70.0),
    ),
)
"""The same farm with three relays and a base station."""


DRAWN = replace(CONFIG, env=EnvConfig("tests.rollout.envs.toy_pictures:Drawn", '{"stay": 40}'))
"""An environment that is no farm and draws its step number as a grey."""


def some_actors(config: RunConfig = CONFIG) -> TeamActors:
    """Return actors that fly somewhere."""
    team = environment_spec(config).team
    actors = TeamActors.initial(team, 8, seed=0, head="gaussian" if config is DRAWN else "deterministic")
    return TeamActors(team, 8, tuple(flat * np.float32(8.0) for flat in actors.flat), actors.head)


def a_collector() -> Collector:
    """Return a collector whose episodes are always the same."""
    return Collector(CONFIG, "w", 1)


def until(condition: Callable[[], Any], what: str, seconds: float = SECONDS) -> Any:
    """Return the first true value of a condition; fail the test when none comes in time."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if found := condition():
            return found
        time.sleep(0.01)
    raise AssertionError(f"{what} did not happen within {seconds} s")


class ARequest:
    """A request that remembers its answer."""

    def __init__(self, payload: bytes) -> None:
        self.payload = payload
        self.answer: bytes | None = None
        self.refusal = ""

    def reply(self, payload: bytes) -> None:
        """Remember an answer."""
        self.answer = payload

    def refuse(self, reason: str) -> None:
        """Remember a refusal."""
        self.refusal = reason


class ABus:
    """What `ViewService` uses of a bus: requests that the test makes, and puts that it reads."""

    def __init__(self) -> None:
        self.requests: deque[ARequest] = deque()
        self.views: list[ViewMessage] = []
        self.sequences: list[int] = []

    def serve(self, key: str, capacity: int, *, newest: bool = False) -> "ABus":
        """Return what is polled for requests."""
        return self

    def publish(self, key: str, encoding: str = "") -> "ABus":
        """Return what is put on."""
        return self

    def waiting(self) -> Iterator[ARequest]:
        """Yield the requests that wait."""
        while self.requests:
            yield self.requests.popleft()

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Remember what was published."""
        self.views.append(ViewMessage.decode(payload))
        self.sequences.append(Envelope.decode(attachment).sequence)

    def ask(self, watcher: str, stay: bool = True) -> ARequest:
        """Make a request."""
        request = ARequest(WatchRequest(watcher, stay).encode())
        self.requests.append(request)
        return request


class AWorker:
    """A worker's loop by hand.

    Attributes:
        now: its clock, s.
    """

    def __init__(self) -> None:
        self.bus, self.now, self.actors = ABus(), 100.0, some_actors()
        self.collector = a_collector()
        self.view_service = ViewService(self.bus, RUN, "w", 1, self.collector, to_toml(CONFIG), clock=lambda: self.now)

    def fly(self, chunks: int = 1, seconds: float = 0.01) -> None:
        """Fly so many chunks, each of which takes so long."""
        for _ in range(chunks):
            self.view_service.poll(3, 0.1, False)
            self.collector.collect(self.actors, 0.1, False)
            self.now += seconds


def flying(
    name: str = "w", endpoint: Endpoint | None = None, config: RunConfig = CONFIG
) -> AbstractContextManager[tuple[Endpoint, ViewService]]:
    """Fly and show a small farm, as a worker does."""
    return pictures.flying(config, some_actors(config), RUN, name, endpoint, noise=0.1)
