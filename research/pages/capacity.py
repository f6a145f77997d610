"""Where a larger run saturates: measured rates of single parts in a small model of learning on policy.

    python -m research.pages.capacity [--workers 50] [--step-ms 20] [--update-us 60] [--link-gbit 10] ...

prints the table for a plan; `python -m research.pages.pages` writes the one for the preset instant into
docs/explanation/capacity.md. The model has no queues and no contention: each part has a rate at which it is busy all
the time, and the run goes at the lowest.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import OnPolicyConfig, RunConfig
from eia_sec.common.config.checks import not_negative, positive, within
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol.messages import ParametersMessage
from eia_sec.common.team import TeamSpec
from eia_sec.deploy.exit_codes import DONE, run_command
from eia_sec.deploy.options import parse
from research.pages.blocks import wrapped

PRESET: Final = "instant"
"""The preset whose run the model describes."""
SOURCES: Final = (
    "research/results/on_policy.json",
    "research/results/intake/intake.json",
    "research/results/distribution/results.json",
)
"""Results that the model stands on, see `Measured.of`, and the runs that it is held against."""
DIRECT: Final = {"TCP": "EIA-SEC, TCP", "shared memory": "EIA-SEC, shared memory"}
ROUTED: Final = "EIA-SEC, TCP through a router"
SIZES: Final = ("131072", "1048576")
"""Chunk sizes through which, and beyond which, the time of a chunk is taken for a straight line."""
ROUND_TRIPS: Final = (1.0, 20.0, 40.0, 100.0, 200.0)
"""Milliseconds that the page shows."""
STEP_TIMES: Final = (0.0, 1.0, 5.0, 20.0, 100.0)
"""Milliseconds of an environment's step that the page shows."""


@dataclass(frozen=True)
class Plan:
    """A run to plan: print which part of it saturates first."""

    workers: int = 1
    """Rollout workers."""
    step_ms: float = 0.0
    """Milliseconds that a step takes besides the worker's own computations, as with vehicles or slow simulators."""
    collect_us: float | None = None
    """Microseconds of a worker's core for an environment step. Default: as measured."""
    update_us: float | None = None
    """Microseconds of the learner's core for an environment step, all updates together. Default: as measured."""
    environments: int = RunConfig().rollout.environments
    """Environments of a worker, `rollout.environments`, which step one after another."""
    chunk_steps: int = RunConfig().rollout.chunk_steps
    """Steps of each in one chunk, `rollout.chunk_steps`."""
    iteration_steps: int = RunConfig().on_policy.iteration_steps
    """Environment steps of an iteration, `algorithm.iteration_steps`; parameters are published after each."""
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
        within(1, 4096, environments=self.environments)
        within(1, 10_000, chunk_steps=self.chunk_steps)
        within(1, 100_000_000, iteration_steps=self.iteration_steps)
        not_negative(step_ms=self.step_ms)
        positive(link_gbit=self.link_gbit, round_trip_ms=self.round_trip_ms)
        given = {"collect_us": self.collect_us, "update_us": self.update_us}
        positive(**{name: value for name, value in given.items() if value is not None})


@dataclass(frozen=True)
class Measured:
    """What single parts were measured to do.

    Attributes:
        collect_us: microseconds of one core in which a worker collects an environment step.
        update_us: microseconds of one core in which the learner learns from one.
        step_bytes: bytes of its rows.
        intake: for each transport, environment steps and bytes a second at each chunk size.
        origins: command and commit of each source.
    """

    collect_us: float
    update_us: float
    step_bytes: float
    intake: Mapping[str, Mapping[str, Mapping[str, float]]]
    origins: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, on_policy: dict[str, Any], intake: dict[str, Any], *others: dict[str, Any]) -> "Measured":
        """Read results; raise ConfigError when the parts were measured with another team."""
        for source, name in ((on_policy, PRESET), (intake, "study")):
            if source.get("team") != farm_team(preset(name).farm).digest:
                raise ConfigError(f"`{source['command']}` was measured with another team; run it again.")
        return cls(
            collect_us=on_policy["collecting"],
            update_us=on_policy["updates"],
            step_bytes=on_policy["step_bytes"],
            intake=intake["transports"],
            origins=tuple((source["command"], source["commit"]) for source in (on_policy, intake, *others)),
        )

    def intake_rate(self, transport: str, size: float) -> float:
        """Return environment steps a second that come in as chunks of some bytes.

        A chunk's time is taken to be a fixed part and one for each byte, through the two sizes that were measured.
        """
        (small, slow), (large, long) = (
            (int(name), int(name) / (self.intake[transport][name]["mb_per_second"] * 1e6)) for name in SIZES
        )
        seconds = max(0.0, slow + (long - slow) * (size - small) / (large - small))
        return size / self.step_bytes / max(seconds, 1e-9)


def parameter_bytes(algorithm: OnPolicyConfig, team: TeamSpec) -> int:
    """Return the bytes of one publication of all actors."""
    shared = algorithm.shared
    actors = TeamActors.initial(team, algorithm.hidden, 0, head="gaussian", shared=shared, memory=algorithm.memory)
    message = ParametersMessage(1, 1, 0, 0, 0.0, team.digest, actors.hidden, actors.head, actors.flat)
    return len(message.encode())


def saturation(plan: Plan, measured: Measured) -> dict[str, float]:
    """Return, for each part, the environment steps a second of the whole run at which it is busy all the time."""
    config = preset(PRESET)
    size = measured.step_bytes * plan.steps
    published = parameter_bytes(config.on_policy, farm_team(config.farm))
    link = plan.link_gbit * 1e9 / 8.0
    rates = {"learner's updates": 1e6 / (plan.update_us or measured.update_us)}
    rates |= {f"intake, {name}": measured.intake_rate(transport, size) for name, transport in DIRECT.items()}
    rates["intake through a router"] = measured.intake_rate(ROUTED, size)
    rates["link, transitions in"] = link / measured.step_bytes
    rates["link, parameters out"] = link / (published * plan.workers) * plan.iteration_steps
    rates["workers"] = plan.workers * worker_rate(plan, measured)
    return rates


def worker_rate(plan: Plan, measured: Measured) -> float:
    """Return the environment steps a second of one worker that waits for an answer before each chunk.

    With room in the iteration it does not wait, so distance costs less than this.
    """
    computing = (plan.collect_us or measured.collect_us) * 1e-6
    chunk = plan.steps * computing + plan.chunk_steps * plan.step_ms / 1000.0
    return plan.steps / (chunk + plan.round_trip_ms / 1000.0)


def table(plan: Plan, measured: Measured) -> list[str]:
    """Return the model's answer for a plan as Markdown: each part, the least first."""
    alone = worker_rate(plan, measured)
    rows = ["| part | saturates at | as workers |", "|---|---:|---:|"]
    for name, rate in sorted(saturation(plan, measured).items(), key=lambda item: item[1]):
        label = f"workers ({plan.workers})" if name == "workers" else name
        rows.append(f"| {label} | {rate:,.0f} | {rate / alone:,.2f} |")
    return rows


def _slow_rows(measured: Measured) -> list[str]:
    """Return how many workers keep the learner busy, by the time of a step."""
    plans = [Plan(step_ms=ms, environments=1, chunk_steps=100) for ms in STEP_TIMES]
    rates = [worker_rate(plan, measured) for plan in plans]
    busy = [1e6 / measured.update_us / rate for rate in rates]
    return [
        "| a step takes, ms, besides the worker's computations | " + " | ".join(f"{ms:g}" for ms in STEP_TIMES) + " |",
        "|---|" + "---:|" * len(STEP_TIMES),
        "| environment steps a second of one worker | " + " | ".join(f"{rate:,.0f}" for rate in rates) + " |",
        "| workers that keep the learner busy | " + " | ".join(f"{number:,.1f}" for number in busy) + " |",
    ]


def _conditions(plan: Plan, measured: Measured) -> str:
    """Return what a step takes and weighs."""
    config = preset(PRESET)
    sent = parameter_bytes(config.on_policy, farm_team(config.farm))
    return wrapped(
        f"""On one core, {measured.collect_us:.0f} us go into collecting a step and {measured.update_us:.0f} us into
        learning from it. Its rows are {measured.step_bytes:,.0f} bytes, a chunk of {plan.steps:,} steps
        {measured.step_bytes * plan.steps / 1e6:.1f} MB. One publication of all actors is {sent / 1000:,.0f} KB, sent to
        each worker after every iteration of {plan.iteration_steps:,} steps."""
    )


def _held_against(measured: Measured, distribution: dict[str, Any]) -> str:
    """Return what whole runs on one machine did."""
    cores = distribution["cores"]
    runs = [f"{line['steps_per_second']:,.0f} with {line['workers']}" for line in distribution["farm"]]
    limit = cores * 1e6 / (measured.update_us + measured.collect_us)
    return wrapped(
        f"""Whole runs on {cores} cores learned from this many steps a second, by number of workers: {", ".join(runs)}
        ([measurement](../../research/results/distribution/README.md)). If collecting and learning took as long as each
        alone, and shared the cores without loss, it would be {limit:,.0f}."""
    )


def block(on_policy: dict[str, Any], intake: dict[str, Any], distribution: dict[str, Any]) -> str:
    """Return the generated part of docs/explanation/capacity.md."""
    measured, plan = Measured.of(on_policy, intake, distribution), Plan()
    far = [f"{worker_rate(Plan(round_trip_ms=ms), measured):,.0f}" for ms in ROUND_TRIPS]
    return "\n".join(
        [
            "The preset instant with one worker on a core of its own and a link of 1 Gbit/s, in environment steps a",
            "second and as a number of workers:",
            "",
            *table(plan, measured),
            "",
            _conditions(plan, measured),
            "",
            _held_against(measured, distribution),
            "",
            "With environments that take time, one in each worker and chunks of 100 steps:",
            "",
            *_slow_rows(measured),
            "",
            "A worker that waits for the answer to each chunk:",
            "",
            "| round trip, ms | " + " | ".join(f"{ms:,.0f}" for ms in ROUND_TRIPS) + " |",
            "|---|" + "---:|" * len(ROUND_TRIPS),
            "| environment steps a second of one worker | " + " | ".join(far) + " |",
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
    measured = Measured.of(*(json.loads(Path(source).read_text(encoding="utf-8")) for source in SOURCES[:2]))
    sys.stdout.write("\n".join(table(plan, measured)) + "\n")
    return DONE


if __name__ == "__main__":
    sys.exit(run_command(main))
