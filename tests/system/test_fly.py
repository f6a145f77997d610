"""Flying over the path: a node in a process of its own, the simulator or a single vehicle at the other end."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from eia_sec.common.actions.adapters import SIGNS
from eia_sec.common.actors import TeamActors
from eia_sec.common.config.files import to_toml
from eia_sec.common.farm import farm_team
from eia_sec.common.gru import Memory
from eia_sec.common.policy_file import save_policy
from eia_sec.common.process import StopSignal
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import MetricMessage, SetpointMessage
from eia_sec.common.protocol.metrics import METRICS, undeclared
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.flight.simulator import SimulatedFleet
from eia_sec.deploy.flight.vehicle import VehicleLink
from eia_sec.rollout.evaluation import episode_seed, evaluate
from eia_sec.rollout.policies import ActorPolicy
from eia_sec.rollout.sim.batch import FarmBatch
from tests.system.fleet import RUN, TINY, configured, until

FARM = configured().farm
TEAM = farm_team(FARM)
FASTEST = (FARM.world.speed_x_max, FARM.world.speed_y_max)
RATE = 50.0
SECONDS = 90.0


class Node:
    """An `eia-sec fly` process and its policy."""

    def __init__(self, folder: Path, toml: str = TINY, *, shared: bool = False, memory: Memory = "none") -> None:
        self.farm = configured(toml).farm
        team = farm_team(self.farm)
        self.actors = TeamActors.initial(team, 16, 5, per_type=False, shared=shared, memory=memory)
        for parameters in self.actors.flat:
            np.multiply(parameters, 8.0, out=parameters)  # fresh actors hardly move
        self.endpoint: Endpoint = free_endpoint()
        self.config = folder / "farm.toml"
        self.config.write_text(to_toml(configured(toml)), encoding="utf-8")
        save_policy(folder / "actors.safetensors", self.actors, {})
        self.log = folder / "fly.log"
        command = ["fly", "--policy", str(folder / "actors.safetensors"), "--config", str(self.config)]
        command += ["--run", RUN, "--listen", str(self.endpoint), "--rate", str(RATE)]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "eia_sec.deploy.cli", *command], stdout=log, stderr=log
            )

    def bus(self) -> Bus:
        """Return a session with it."""
        return Bus.connect(self.endpoint, "control", wait=SECONDS, waiting=lambda: self.process.poll() is None)

    def close(self) -> None:
        """End it by force."""
        self.process.kill()
        self.process.wait(10.0)


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Node]:
    """A flight node that serves every agent of a small farm."""
    flying = Node(tmp_path_factory.mktemp("fly"))
    yield flying
    flying.close()


@pytest.fixture(scope="module")
def choosing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Node]:
    """A flight node whose actors choose headings and moves, each type with one row of parameters."""
    control = '[farm.control]\ncommunication = "headings"\nmonitoring = "moves"\ncollection = "moves"\n'
    flying = Node(tmp_path_factory.mktemp("choose"), TINY + control, shared=True)
    yield flying
    flying.close()


@pytest.fixture(scope="module")
def remembering(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Node]:
    """A flight node whose actors have memory."""
    flying = Node(tmp_path_factory.mktemp("remember"), memory="gru")
    yield flying
    flying.close()


@pytest.mark.parametrize("which", ["node", "choosing", "remembering"])
def test_decisions_over_the_path_are_those_in_one_process_bit_for_bit(
    which: str, request: pytest.FixtureRequest
) -> None:
    """An episode over the bus has the same actions and result as one without it."""
    node: Node = request.getfixturevalue(which)
    with node.bus() as bus:
        links = {agent: VehicleLink(bus, RUN, agent, agent, FASTEST) for agent in TEAM.agent_names}
        flight = SimulatedFleet(node.farm, links, SECONDS).fly(1003, 0, StopSignal())
    alone, policy = FarmBatch(node.farm, 1), ActorPolicy(node.actors)
    alone.reset(0, 1003, episode_seed(1003, 0))
    policy.reset(alone, 0)
    actions = []
    while not alone.ended.all():
        actions.append(policy.act(alone)[0])
        alone.step(actions[-1][None])
    assert len(flight.actions) == len(actions) == FARM.world.steps
    assert np.stack(flight.actions).tobytes() == np.stack(actions).tobytes()
    assert flight.summary == alone.summary(0)
    assert np.abs(np.stack(actions)).max() > 0.5
    assert len(flight.round_trips) == len(actions) * TEAM.agents


def test_hover_is_commanded_in_the_period_after_observations_stop(node: Node) -> None:
    """By the node's own count of periods: the set-point after the last decision commands hover, and so do all later."""
    agent = TEAM.agent_names[-1]
    values = np.random.default_rng(0).uniform(-1, 1, TEAM.groups[-1].observation_size).astype(np.float32)
    values[SIGNS] = 1.0
    with node.bus() as bus:
        link = VehicleLink(bus, RUN, agent, agent, FASTEST)
        decided: list[SetpointMessage] = []
        after: list[SetpointMessage] = []

        def answered() -> bool:
            found = link.setpoints()
            decided.extend(message for message in found if not message.hover)
            if decided:
                after.extend(message for message in found if message.period > decided[-1].period)
            return bool(decided)

        until(lambda: link.observe(values) and answered(), "a decision")
        until(lambda: answered() and len(after) >= 10, "set-points after the last observation")
        link.refused = 0
    last = max(message.period for message in decided)
    later = [message for message in after if message.period > last]
    assert later[0].period == last + 1
    assert all(message.hover and message.velocity == (0.0, 0.0) for message in later)
    assert later[0].reason == "no observation for 1 period"


def test_the_simulator_command_flies_over_the_path(node: Node) -> None:
    """`eia-sec simulator` flies the episode that `eia-sec evaluate` would fly, and says how long decisions took."""
    command = ["simulator", "--config", str(node.config), "--run", RUN, "--connect", str(node.endpoint), "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "eia_sec.deploy.cli", *command, "--farm", "1001"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr + node.log.read_text()
    found = json.loads(done.stdout)
    wanted = evaluate(FARM, ActorPolicy(node.actors), [1001], 1, name="x").total
    assert (found["steps"], found["refused"]) == (FARM.world.steps, 0)
    assert found["reward"] == pytest.approx(wanted.reward, rel=1e-12)
    assert 0 < found["round_trip_ms"]["median"] <= found["round_trip_ms"]["most"]


def test_the_node_publishes_its_latencies_and_ends_with_hover(node: Node) -> None:
    """It reports the declared metrics, including latencies; on SIGTERM it commands hover and exits with code 0."""
    reports: list[MetricMessage] = []
    with node.bus() as bus:
        metrics = bus.subscribe(keys.METRIC.key(RUN, role="flight", name="main"), 16)
        link = VehicleLink(bus, RUN, TEAM.agent_names[0], TEAM.agent_names[0], FASTEST)
        last: list[SetpointMessage] = []

        def both_arrived() -> bool:
            reports.extend(MetricMessage.decode(sample.payload) for sample in metrics.drain())
            return bool(reports and link.setpoints())

        until(both_arrived, "metrics and set-points")
        node.process.send_signal(signal.SIGTERM)
        until(lambda: last.extend(link.setpoints()) or (last and "stopping" in last[-1].reason), "the last hover")
        assert node.process.wait(SECONDS) == 0
    values = reports[-1].values
    assert undeclared("flight", values) == []
    assert {metric.name.split("/")[0] for metric in METRICS["flight"]} == set(values)
    assert values["decisions"] > 0
    assert 0 < values["latency"]["median"] <= values["latency"]["most"]
    assert last[-1].hover
