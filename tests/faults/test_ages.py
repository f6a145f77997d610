"""Limits of age on the worker's side: actors that are too old, a learner that is silent; a scripted learner plays."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.files import to_toml
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_messages import from_request
from eia_sec.common.protocol.messages import (
    ChunkAck,
    ConfigurationMessage,
    Envelope,
    MetricMessage,
    ParametersMessage,
    ProgressMessage,
)
from eia_sec.common.transport.bus import Bus
from eia_sec.rollout.envs.registry import environment_spec
from tests.system.fleet import RUN, TINY, Processes, configured, until

LAG, SILENCE = 5, 1.5
REPORTS = 3
"""Reports in a row that show a worker standing still, or flying."""


class Learner:
    """Answers and publishes what a test wants; a worker cannot distinguish it from a real learner."""

    def __init__(self, toml: str, control: Bus, bulk: Bus) -> None:
        config = configured(toml)
        self._toml, self._team = to_toml(config), environment_spec(config).team
        self._actors = TeamActors.initial(self._team, 16, 0)
        self._commands = control.serve(keys.COMMAND.pattern(RUN), 16)
        self._chunks = bulk.serve(keys.TRANSITION.pattern(RUN), 16)
        self._parameters = control.publish_state(keys.PARAMETERS.key(RUN))
        self._progress = control.publish_state(keys.PROGRESS.key(RUN))
        self._metrics = control.subscribe(keys.METRIC.pattern(RUN), 256)
        self.reports: list[MetricMessage] = []
        self.newest = 1
        self.talks = True

    def publish(self, version: int) -> None:
        """Publish actors of a version."""
        message = ParametersMessage(1, version, 0, 1000, 0.5, self._team.digest, 16, "deterministic", self._actors.flat)
        self._parameters.put(message.encode())

    def pump(self) -> None:
        """Answer what has come, publish the progress, and take in reports."""
        while (incoming := self._commands.poll()) is not None:
            incoming.reply(ConfigurationMessage(1, self._toml, self._team.to_dict(), False).encode())
        while (incoming := self._chunks.poll()) is not None:
            sender = Envelope.decode(incoming.attachment)
            count = len(from_request(incoming.payload)[1])
            taken = ("accepted",) * count, ("",) * count
            incoming.reply(ChunkAck(*taken, sender.sequence + count, 0).encode())
        if self.talks:
            self._progress.put(ProgressMessage(1, self.newest, 0, 1, 1000, 1, "training").encode())
        found = [MetricMessage.decode(sample.payload) for sample in self._metrics.drain()]
        self.reports += [report for report in found if report.values["state"] != "starting"]

    def expect_flying(self) -> None:
        """Wait for some reports in a row in which the worker has flown on and names no reason not to."""
        self._until(lambda steps, paused: len(set(steps)) == REPORTS and not any(paused), "flying")

    def expect_standing(self, reason: str) -> None:
        """Wait for some reports in a row in which the worker has not flown, each with the reason."""
        self._until(lambda steps, paused: len(set(steps)) == 1 and all(reason in text for text in paused), reason)

    def _until(self, holds, what: str) -> None:
        self.reports.clear()

        def seen() -> bool:
            self.pump()
            values = [report.values for report in self.reports[-REPORTS:]]
            steps = [value["environment_steps"] for value in values]
            return len(values) == REPORTS and holds(steps, [value["paused"] for value in values])

        until(seen, what)


@contextmanager
def scripted(tmp_path: Path, settings: str, toml: str = TINY) -> Iterator[Learner]:
    """Give a scripted learner with one real worker, which flies."""
    toml = toml.replace("[rollout]\n", f"[rollout]\n{settings}\n")
    fleet = Processes(tmp_path, toml)
    try:
        with Bus.listen(fleet.endpoint, "control") as control, Bus.listen(fleet.endpoint, "bulk") as bulk:
            learner = Learner(toml, control, bulk)
            fleet.worker()
            learner.publish(1)
            learner.expect_flying()
            yield learner
    finally:
        fleet.close()


def test_a_worker_with_actors_that_are_too_old_stands_still(tmp_path):
    """Beyond `rollout.max_lag_versions` it stops, says why and goes on with newer actors; at the limit it flies."""
    with scripted(tmp_path, f"max_lag_versions = {LAG}") as learner:
        learner.newest = 1 + LAG
        learner.expect_flying()
        learner.newest = 2 + LAG
        learner.expect_standing(f"its actors are {LAG + 1} versions old, more than {LAG}")
        assert "versions old" in learner.reports[-1].values["alarms"][0]
        assert learner.reports[-1].values["paused_seconds"] > 0
        learner.publish(2 + LAG)
        learner.expect_flying()


def test_a_worker_that_hears_nothing_of_the_learner_stands_still(tmp_path):
    """After `rollout.max_silence_seconds` without word it stops and says so, and goes on as soon as it hears again."""
    with scripted(tmp_path, f"max_silence_seconds = {SILENCE}") as learner:
        learner.talks = False
        learner.expect_standing("the learner has been silent for")
        learner.talks = True
        learner.expect_flying()


def test_a_worker_reports_while_it_collects_a_chunk(tmp_path):
    """Its steps rise although it has produced no further chunk; else it would look as if it hung."""
    long = TINY.replace("chunk_steps = 10\n", "chunk_steps = 10000\n").replace("capacity = 4096", "capacity = 65536")
    with scripted(tmp_path, "", long) as learner:
        learner.reports.clear()

        def seen() -> bool:
            learner.pump()
            return any(each.values["environment_steps"] > each.values["produced"] for each in learner.reports)

        assert until(seen, "a report within a chunk")


def test_without_limits_a_worker_flies_on(tmp_path):
    """By default neither age nor silence stops a worker."""
    with scripted(tmp_path, "") as learner:
        learner.newest = 1_000_000
        learner.expect_flying()
        learner.talks = False
        learner.expect_flying()
