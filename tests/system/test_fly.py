"""Flying over the path: nodes in processes of their own, the simulator or single vehicles at the other end."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.files import to_toml
from eia_sec.common.farm import farm_team
from eia_sec.common.gru import Memory
from eia_sec.common.policy_file import save_policy
from eia_sec.common.process import StopSignal
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import MetricMessage
from eia_sec.common.protocol.metrics import METRICS, undeclared
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.flight.simulator import SimulatedFleet
from eia_sec.deploy.flight.vehicle import Pose, VehicleLink
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

    def __init__(
        self,
        folder: Path,
        toml: str = TINY,
        *more: str,
        shared: bool = False,
        memory: Memory = "none",
        connect: Endpoint | None = None,
    ) -> None:
        self.farm = configured(toml).farm
        team = farm_team(self.farm)
        self.actors = TeamActors.initial(team, 16, 5, per_type=False, shared=shared, memory=memory)
        for parameters in self.actors.flat:
            np.multiply(parameters, 8.0, out=parameters)  # fresh actors hardly move
        self.endpoint: Endpoint = connect or free_endpoint()
        self.config = folder / "farm.toml"
        self.config.write_text(to_toml(configured(toml)), encoding="utf-8")
        save_policy(folder / "actors.safetensors", self.actors, {})
        self.log = folder / "fly.log"
        command = ["fly", "--policy", str(folder / "actors.safetensors"), "--config", str(self.config)]
        command += [
            "--run",
            RUN,
            "--connect" if connect else "--listen",
            str(self.endpoint),
            "--rate",
            str(RATE),
            *more,
        ]
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


LOCKSTEP = ("--lockstep", "--farm", "1003")
CHOICES = TINY + '[farm.control]\ncommunication = "headings"\nmonitoring = "moves"\ncollection = "moves"\n'


def links_of(bus: Bus) -> dict[str, VehicleLink]:
    """Return a link for every agent's vehicle."""
    return {agent: VehicleLink(bus, RUN, agent, agent, FASTEST) for agent in TEAM.agent_names}


def tell(links: dict[str, VehicleLink], *but: str) -> bool:
    """Let all vehicles but some tell where they are; return True."""
    for number, (name, link) in enumerate(links.items()):
        if name not in but:
            link.publish(Pose((10.0 + 15.0 * number, 50.0), 20.0, (0.0, 0.0)))
    return True


@pytest.mark.parametrize("which", ["continuous", "choosing", "remembering"])
def test_decisions_over_the_path_are_those_in_one_process_bit_for_bit(which: str, tmp_path: Path) -> None:
    """An episode over the bus has the same actions and result as one without it; then the node ends by itself."""
    toml = CHOICES if which == "choosing" else TINY
    memory: Memory = "gru" if which == "remembering" else "none"
    node = Node(tmp_path, toml, *LOCKSTEP, shared=which == "choosing", memory=memory)
    try:
        with node.bus() as bus:
            links = links_of(bus)
            flight = SimulatedFleet(node.farm, links, SECONDS).fly(1003, 0, StopSignal())
            last = links[TEAM.agent_names[0]]
            until(lambda: "are over" in last.setpoint().reason, "the last hover")
            assert node.process.wait(SECONDS) == 0
    finally:
        node.close()
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


def test_a_vehicle_whose_poses_stop_hovers_while_the_others_fly(tmp_path: Path) -> None:
    """By the clock, without lockstep: decisions go on, and the reason names the silence."""
    node = Node(tmp_path)
    silent, other = TEAM.agent_names[-1], TEAM.agent_names[0]
    try:
        with node.bus() as bus:
            links = links_of(bus)
            until(lambda: tell(links) and not any(link.setpoint().hover for link in links.values()), "decisions of all")
            until(lambda: tell(links, silent) and "no pose for" in links[silent].setpoint().reason, "hover")
            assert not links[other].setpoint().hover
            before = links[other].setpoint().decision
            until(lambda: tell(links) and links[other].setpoint().decision > before, "the next decision")
            until(lambda: tell(links) and not links[silent].setpoint().hover, "a decision for all again")
    finally:
        node.close()


def test_of_two_nodes_one_flies_and_the_other_takes_over_when_it_is_killed(tmp_path: Path) -> None:
    """Vehicles obey the first; both say so in their metrics. After kill -9 vehicles hover, then obey the second."""
    endpoint = free_endpoint()
    nodes: dict[str, Node] = {}

    def start(name: str) -> None:
        folder = tmp_path / name
        folder.mkdir()
        nodes[name] = Node(folder, TINY, "--name", name, "--patience", str(SECONDS), connect=endpoint)

    with Bus.listen(endpoint, "control") as bus:
        links = links_of(bus)
        reports: dict[str, MetricMessage] = {}
        metrics = bus.subscribe(keys.METRIC.pattern(RUN, role="flight"), 64)

        def told() -> dict[str, str]:
            tell(links)
            for link in links.values():
                link.setpoint()
            for sample in metrics.drain():
                reports[sample.key.rsplit("/", 1)[1]] = MetricMessage.decode(sample.payload)
            return {name: " ".join(report.values["alarms"]) for name, report in reports.items()}

        try:
            start("first")
            until(lambda: told() is not None and {link.node for link in links.values()} == {"first"}, "the first node")
            start("second")
            until(
                lambda: (
                    "the flight node second claims them" in told().get("first", "")
                    and "the flight node first; this one stands by" in told().get("second", "")
                ),
                "both nodes' sentences",
            )
            assert all(link.refused > 0 for link in links.values())
            assert reports["second"].values["standing_by"] == TEAM.agents
            assert undeclared("flight", reports["second"].values) == []
            nodes["first"].close()
            until(
                lambda: told() is not None and {link.node for link in links.values()} == {"second"}, "the second node"
            )
            assert all(link.lapses for link in links.values())  # everyone hovered by itself in between
            until(lambda: told() is not None and not any(link.setpoint().hover for link in links.values()), "decisions")
        finally:
            for node in nodes.values():
                node.close()


def test_the_simulator_command_flies_over_the_path(tmp_path: Path) -> None:
    """`eia-sec simulator` flies the episode that `eia-sec evaluate` would fly, and says how long decisions took."""
    record = tmp_path / "flight.mcap"
    node = Node(tmp_path, TINY, "--lockstep", "--farm", "1001", "--record", str(record))
    command = ["simulator", "--config", str(node.config), "--run", RUN, "--connect", str(node.endpoint), "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "eia_sec.deploy.cli", *command, "--farm", "1001"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert node.process.wait(SECONDS) == 0
    assert done.returncode == 0, done.stderr + node.log.read_text()
    found = json.loads(done.stdout)
    wanted = evaluate(FARM, ActorPolicy(node.actors), [1001], 1, name="x").total
    assert (found["steps"], found["refused"]) == (FARM.world.steps, 0)
    assert found["reward"] == pytest.approx(wanted.reward, rel=1e-12)
    assert 0 < found["round_trip_ms"]["median"] <= found["round_trip_ms"]["most"]
    with record.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = {summary.channels[k].topic: n for k, n in summary.statistics.channel_message_counts.items()}
    assert counts["/farm/map"] == FARM.world.steps + 1
    assert {topic.rsplit("/", 1)[1] for topic in counts} == {"map", "tf", "pose", "setpoint"}
    assert counts["/tf"] == sum(n for topic, n in counts.items() if topic.endswith("/pose"))


def test_the_node_publishes_its_latencies_and_ends_with_hover(tmp_path: Path) -> None:
    """It reports the declared metrics, including latencies; on SIGTERM it commands hover and exits with code 0."""
    node = Node(tmp_path)
    reports: list[MetricMessage] = []
    try:
        with node.bus() as bus:
            metrics = bus.subscribe(keys.METRIC.key(RUN, role="flight", name="main"), 16)
            links = links_of(bus)
            link = links[TEAM.agent_names[0]]

            def reported() -> bool:
                tell(links)
                reports.extend(MetricMessage.decode(sample.payload) for sample in metrics.drain())
                return bool(reports and reports[-1].values["decisions"] > 0)

            until(reported, "metrics of decisions")
            node.process.send_signal(signal.SIGTERM)
            until(lambda: "stopping" in link.setpoint().reason, "the last hover")
            assert node.process.wait(SECONDS) == 0
            until(lambda: "validity is over" in link.setpoint().reason, "hover by the vehicle itself")
    finally:
        node.close()
    values = reports[-1].values
    assert undeclared("flight", values) == []
    with_record = {"recorded", "unrecorded"}
    assert {metric.name.split("/")[0] for metric in METRICS["flight"]} - with_record == set(values)
    assert 0 < values["latency"]["median"] <= values["latency"]["most"]
