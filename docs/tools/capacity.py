"""Where a larger run saturates: measured rates of single parts in a small model.

    python -m docs.tools.capacity [--workers 50] [--update-ms 1.2] [--link-gbit 10] ...

prints the table for a plan; `python -m docs.tools.pages` writes the one for the defaults into
docs/explanation/capacity.md. The model has no queues and no contention: each part has a rate at which it is busy all
the time, and the run goes at the lowest.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from common.actors import TeamActors
from common.config import RunConfig
from common.config.checks import positive, within
from common.config.presets import PRESETS, preset
from common.errors import ConfigError
from common.farm import farm_team
from common.protocol.chunk_messages import fitting
from common.protocol.messages import ParametersMessage
from common.team import TeamSpec
from deploy.exit_codes import DONE, run_command
from deploy.options import parse

PRESET: Final = "eia-sec"
"""The preset whose run the model describes: workers send to a replay buffer, and updates go on meanwhile."""
SOURCES: Final = (
    "docs/results/intake/intake.json",
    "docs/results/learner/growth.json",
    "docs/results/second_worker.json",
)
"""Results that the model stands on, see `Measured.of`."""
DIRECT: Final = {"TCP": "EIA-SEC, TCP", "shared memory": "EIA-SEC, shared memory"}
ROUTED: Final = "EIA-SEC, TCP through a router"
SIZES: Final = ("131072", "1048576")
"""Chunk sizes between and beyond which the time of a chunk is taken for a straight line."""
ROUND_TRIPS: Final = (1.0, 20.0, 40.0, 100.0, 200.0)
"""Milliseconds that the page shows."""


@dataclass(frozen=True)
class Plan:
    """A run to plan: print which part of it saturates first."""

    workers: int = 1
    """Rollout workers."""
    worker_rate: float | None = None
    """Environment steps a second that one worker flies. Default: as measured."""
    update_ms: float | None = None
    """Milliseconds of one update of all agents. Default: as measured on one core."""
    updates_per_step: float = PRESETS[PRESET].replay.updates_per_step
    """Updates per environment step, `replay.updates_per_step`."""
    environments: int = PRESETS[PRESET].rollout.environments
    """Environments of a worker, `rollout.environments`."""
    chunk_steps: int = PRESETS[PRESET].rollout.chunk_steps
    """Steps of each in one chunk, `rollout.chunk_steps`."""
    spool_chunks: int = PRESETS[PRESET].rollout.spool_chunks
    """Chunks that a worker holds, `rollout.spool_chunks`."""
    publish_seconds: float = PRESETS[PRESET].learner.publish_seconds
    """Pause between two publications of parameters, `learner.publish_seconds`."""
    link_gbit: float = 1.0
    """Link of the learner's host, Gbit/s each way."""
    round_trip_ms: float = 1.0
    """Round trip between a worker and the learner, ms."""

    @property
    def steps(self) -> int:
        """Environment steps of a chunk."""
        return self.environments * self.chunk_steps

    def check(self) -> None:
        """Raise ConfigError when a value is impossible."""
        within(1, 100_000, workers=self.workers)
        within(1, 4096, environments=self.environments, spool_chunks=self.spool_chunks)
        within(1, 10_000, chunk_steps=self.chunk_steps)
        numbers = {
            "worker_rate": self.worker_rate,
            "update_ms": self.update_ms,
            "updates_per_step": self.updates_per_step,
            "publish_seconds": self.publish_seconds,
            "link_gbit": self.link_gbit,
            "round_trip_ms": self.round_trip_ms,
        }
        positive(**{name: value for name, value in numbers.items() if value is not None})


@dataclass(frozen=True)
class Measured:
    """What single parts were measured to do.

    Attributes:
        worker_rate: environment steps a second of one worker, the learner beside it on the same two cores.
        update_ms: one update of twelve agents on one core, ms.
        intake: for each transport, environment steps and bytes a second at each chunk size.
        origins: command and commit of each source.
    """

    worker_rate: float
    update_ms: float
    intake: Mapping[str, Mapping[str, Mapping[str, float]]]
    origins: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, intake: dict[str, Any], growth: dict[str, Any], workers: dict[str, Any]) -> "Measured":
        """Read the results in SOURCES; raise ConfigError when they were measured with another team."""
        present = farm_team(preset("study").farm).digest
        for source in (intake, growth, workers):
            if source.get("team") != present:
                raise ConfigError(f"`{source['command']}` was measured with another team; run it again.")
        wanted = {"algorithm": "eia-sec", "width": PRESETS[PRESET].algorithm.hidden, "agents": 12, "threads": 1}
        updates = [line["ms"] for line in growth["agents"] if wanted.items() <= line.items()]
        return cls(
            worker_rate=workers["environment_steps_per_second"]["one_worker"],
            update_ms=updates[0],
            intake=intake["transports"],
            origins=tuple((source["command"], source["commit"]) for source in (intake, growth, workers)),
        )

    def step_bytes(self) -> float:
        """Return the bytes of one environment step's rows."""
        found = self.intake[ROUTED][SIZES[0]]
        return found["mb_per_second"] * 1e6 / found["env_steps_per_second"]

    def intake_rate(self, transport: str, size: float) -> float:
        """Return environment steps a second that come in as chunks of some bytes.

        A chunk's time is taken to be a fixed part and one for each byte, through the two sizes that were measured.
        """
        (small, slow), (large, long) = (
            (int(name), int(name) / (self.intake[transport][name]["mb_per_second"] * 1e6)) for name in SIZES
        )
        seconds = max(0.0, slow + (long - slow) * (size - small) / (large - small))
        return size / self.step_bytes() / max(seconds, 1e-9)


def parameter_bytes(config: RunConfig, team: TeamSpec) -> int:
    """Return the bytes of one publication of all actors."""
    actors = TeamActors.initial(team, config.algorithm.hidden, 0)
    message = ParametersMessage(1, 1, 0, 0, 0.0, team.digest, actors.hidden, actors.head, actors.flat)
    return len(message.encode())


def saturation(plan: Plan, measured: Measured) -> dict[str, float]:
    """Return, for each part, the environment steps a second of the whole run at which it is busy all the time."""
    config = PRESETS[PRESET]
    size = measured.step_bytes() * plan.steps
    update_ms = plan.update_ms or measured.update_ms
    published = parameter_bytes(config, farm_team(config.farm)) / plan.publish_seconds
    link = plan.link_gbit * 1e9 / 8.0
    rates = {"training": 1000.0 / update_ms / plan.updates_per_step}
    rates |= {f"intake, {name}": measured.intake_rate(transport, size) for name, transport in DIRECT.items()}
    rates["intake through a router"] = measured.intake_rate(ROUTED, size)
    rates["link, transitions in"] = link / measured.step_bytes()
    # Each worker gets its own copy: this bounds how many there are, whatever they fly.
    rates["link, parameters out"] = link / published * (plan.worker_rate or measured.worker_rate)
    rates["workers"] = plan.workers * worker_rate(plan, measured)
    return rates


def worker_rate(plan: Plan, measured: Measured) -> float:
    """Return the environment steps a second of one worker, which has one request under way at a time."""
    size = round(measured.step_bytes() * plan.steps)
    under_way = fitting([size] * plan.spool_chunks)
    delivered = under_way * plan.steps / (plan.round_trip_ms / 1000.0)
    return min(plan.worker_rate or measured.worker_rate, delivered)


def table(plan: Plan, measured: Measured) -> list[str]:
    """Return the model's answer for a plan as Markdown: each part, the least first."""
    flown = plan.worker_rate or measured.worker_rate
    rows = ["| part | saturates at | as workers |", "|---|---:|---:|"]
    for name, rate in sorted(saturation(plan, measured).items(), key=lambda item: item[1]):
        label = f"workers ({plan.workers})" if name == "workers" else name
        rows.append(f"| {label} | {rate:,.0f} | {rate / flown:,.2f} |")
    return rows


def _wider() -> float:
    """Return by which share the whole team's observation is wider in the preset than where it was measured."""
    flown, measured = (farm_team(PRESETS[name].farm).observation_size for name in (PRESET, "study"))
    return flown / measured - 1.0


def block(*data: dict[str, Any]) -> str:
    """Return the generated part of docs/explanation/capacity.md."""
    measured, plan = Measured.of(*data), Plan()
    size = measured.step_bytes() * plan.steps
    config = PRESETS[PRESET]
    sent = parameter_bytes(config, farm_team(config.farm))
    far = [f"{worker_rate(Plan(round_trip_ms=ms), measured):,.0f}" for ms in ROUND_TRIPS]
    return "\n".join(
        [
            f"For the preset `{PRESET}`, which learns from a replay buffer, with one worker and a link of 1 Gbit/s, in",
            "environment steps a second and as a number of workers:",
            "",
            *table(plan, measured),
            "",
            "Rates of workers, updates and intake were measured with the preset `study`. Observations of",
            f"`{PRESET}` have {_wider():.0%} more numbers, so its rates are slightly lower.",
            "",
            f"There, a step is {measured.step_bytes():,.0f} bytes and a chunk of {plan.steps} steps",
            f"{size / 1000:,.0f} KB. One publication of all actors is {sent / 1000:,.0f} KB, sent to each",
            f"worker at most every {plan.publish_seconds} s.",
            "",
            "| round trip, ms | " + " | ".join(f"{ms:,.0f}" for ms in ROUND_TRIPS) + " |",
            "|---|" + "---:|" * len(ROUND_TRIPS),
            "| limit of one worker, environment steps a second | " + " | ".join(far) + " |",
            "",
            "Made from:",
            "",
            *(f"- `{command}`, commit {commit}" for command, commit in measured.origins),
            "",
        ]
    )


def main() -> int:
    """Print the table for a plan; return 0."""
    plan = parse(Plan, sys.argv[1:], "capacity")
    plan.check()
    measured = Measured.of(*(json.loads(Path(source).read_text(encoding="utf-8")) for source in SOURCES))
    sys.stdout.write("\n".join(table(plan, measured)) + "\n")
    return DONE


if __name__ == "__main__":
    sys.exit(run_command(main))
