"""Every metric that a process publishes about itself: name, unit and meaning, by role.

Names of nested maps are joined by a slash; `*` stands for any one name. A test
holds the table against what the processes of a real run report, and `docs/reference/monitoring.md` is made from it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final


@dataclass(frozen=True)
class Metric:
    """One metric.

    Attributes:
        name: where it stands in `MetricMessage.values`.
        unit: what it is counted in; empty for names, texts and plain numbers.
        meaning: what it is.
    """

    name: str
    unit: str
    meaning: str


_STEPS: Final = "environment steps"
_STATE: Final = Metric("state", "", "starting, training, draining or finished")
_ADMISSION: Final = (
    Metric("descriptors", "", "open file descriptors of a process that listens; an alarm from half of the limit on"),
    Metric("waiting_connections", "", "closed by the peer before they were accepted; each delays new members by 0.1 s"),
)
_ALARMS: Final = Metric("alarms", "", "list of sentences that need a person's attention")


def _account(prefix: str, whose: str) -> tuple[Metric, ...]:
    return (
        Metric(
            f"{prefix}/produced",
            _STEPS,
            f"produced by {whose}, as workers report it: accepted + lost + rejected + in_flight + unexplained",
        ),
        Metric(f"{prefix}/accepted", _STEPS, "accepted into replay, or on the way there inside the learner"),
        Metric(f"{prefix}/lost", _STEPS, "lost for good"),
        Metric(f"{prefix}/rejected", _STEPS, "in refused chunks"),
        Metric(f"{prefix}/in_flight", _STEPS, "produced after the last accepted chunk, and not lost"),
        Metric(f"{prefix}/duplicates", "chunks", "received again and ignored"),
        Metric(f"{prefix}/refused", "chunks", "refused"),
        Metric(f"{prefix}/aged", "chunks", "refused because their policy was too old; part of `refused`"),
        Metric(f"{prefix}/damaged", "frames", "that could not be read and were requested again"),
    )


METRICS: Final[dict[str, tuple[Metric, ...]]] = {
    "learner": (
        _STATE,
        Metric("episodes", "episodes", "training episodes finished"),
        Metric("episodes_total", "episodes", "training episodes of the whole run, lambda_max"),
        Metric("environment_steps", _STEPS, "added to replay"),
        Metric("updates", "updates", "gradient updates done"),
        Metric("version", "", "parameter version; grows with every publication"),
        Metric("event", "", "imitation events applied"),
        Metric("lag_versions", "versions", "age of a chunk's policy when it arrives, running mean"),
        Metric("queue", "chunks", "waiting between receiver and replay"),
        Metric(
            "malformed",
            "requests",
            "from unknown workers, against the rules of lockstep, or with a wildcard in the key",
        ),
        Metric("replaced", "requests", "from a worker's start that a newer start has replaced"),
        Metric("malformed_commands", "requests", "refused because they were not valid commands"),
        Metric("malformed_by/*", "requests", "invalid requests by worker: the worst eight, and the sum of the others"),
        Metric("turned_away", "requests", "refused unread because their worker is blocked"),
        Metric("uncounted_episodes", "episodes", "not counted because this learner has not seen all their steps"),
        *_ADMISSION,
        Metric("elapsed", "s", "time since the run began, without pauses between its starts"),
        Metric(
            "waits/*",
            "s",
            "time since this start spent waiting for data, imitation, producers and checkpoint, and training",
        ),
        *_account("ledger", "all workers"),
        Metric(
            "ledger/unexplained",
            _STEPS,
            "by which the workers' accounts do not add up, or that were accepted and are neither in replay nor on the "
            "way to it; 0 unless there is a defect",
        ),
        *_account("ledgers/*", "one worker, over all its starts; of at most 16, the others in `(others)`"),
        Metric(
            "ledgers/*/unexplained",
            _STEPS,
            "produced - accepted - lost - rejected - in_flight: positive if forgotten, negative if counted twice",
        ),
        Metric("ledgers/*/workers", "workers", "summed in `(others)`"),
        Metric(
            "imitations",
            "",
            "list of the newest four events, each a map: event, episode (when it was due), version, "
            "rate (vartheta), elites (index by type), scores (omega of each agent by type), evaluation_steps",
        ),
        Metric("curves/reward/*", "reward", "mean per agent over the newest 40 episodes: all agents, and each type"),
        Metric("curves/steps", "steps", "length of an episode, mean over the same"),
        Metric("curves/*", "", "the environment's episode metrics, means over the same"),
        Metric(
            "environment/*",
            "",
            "labels for views: short_names of types of agents, and episode_metrics, a list of maps with name, unit, "
            "meaning, label, digits, factor, plotted, group",
        ),
        Metric(
            "statistics/*", "", "running means of training diagnostics; docs/how-to/debug_training.md explains each"
        ),
        Metric("evaluation_steps", _STEPS, "of noise-free evaluation for imitation"),
        Metric("checkpoints/*", "", "sizes and times of checkpoints; docs/how-to/debug_training.md"),
        _ALARMS,
    ),
    "rollout": (
        _STATE,
        Metric("environment_steps", _STEPS, "produced since this start"),
        Metric("produced", _STEPS, "the same: accepted + rejected + in_flight, as the worker counts"),
        Metric("accepted", _STEPS, "acknowledged by the learner"),
        Metric("rejected", _STEPS, "in chunks that the learner refused"),
        Metric("in_flight", _STEPS, "produced and not yet acknowledged or refused"),
        Metric("retries", "requests", "sent again"),
        Metric("spooled", "chunks", "held until the learner answers"),
        Metric("simulating_seconds", "s", "time spent simulating"),
        Metric("waiting_seconds", "s", "time spent waiting for room in the spool or for parameters"),
        Metric("evaluations", "episodes", "of noise-free evaluation for imitation"),
        Metric("epoch", "", "epoch of the learner that its actors came from"),
        Metric("version", "", "parameter version of its actors"),
        Metric("event", "", "imitation events applied to its actors"),
        Metric("stale", "messages", "ignored because their parameters or event were not newer"),
        Metric("missed", "messages", "of parameters that were overtaken or lost"),
        Metric("malformed", "messages", "dropped because they could not be read"),
        Metric("paused", "", "why it does not simulate, or empty"),
        Metric("paused_seconds", "s", "time paused"),
        Metric("watchers", "", "number of watchers now"),
        Metric("shown", _STEPS, "published to watchers"),
        Metric("skipped", _STEPS, "simulated while somebody watched, but not published"),
        _ALARMS,
    ),
    "elite": (
        Metric("workers", "", "list of the workers that it can ask"),
        Metric("events", "", "imitation events that the learner has applied"),
        Metric("next_episode", "episodes", "at which the next event is due; 0 if there is none"),
        Metric("failures", "requests", "for evaluations, not answered in time"),
        Metric("malformed", "messages", "and tokens dropped because they could not be read"),
        Metric("leads", "", "whether it holds the learner's lease"),
        Metric("rate", "", "blend factor vartheta of the newest event"),
        Metric("elites/*", "", "index of the newest event's elite inside each type"),
        Metric("scores", "", "omega of each agent in the newest event; a list for each type"),
        _ALARMS,
    ),
    "flight": (
        Metric("period_seconds", "s", "time between two set-points"),
        Metric("periods", "periods", "started"),
        Metric("overruns", "periods", "skipped because the one before took too long"),
        Metric("decisions", "set-points", "from an actor"),
        Metric("hovers", "set-points", "that command hover"),
        Metric("refused", "observations", "not used: malformed, not finite, stale or not newer"),
        Metric("missed", "observations", "that never arrived, by the gaps in their numbers"),
        Metric(
            "latency/*",
            "ms",
            "from an observation's arrival to its set-point, over the newest 1,000: median, p99, most",
        ),
        Metric("age/*", "ms", "age of the observation when its set-point was made, by both clocks, likewise"),
        Metric("vehicles/*/agent", "", "the agent that flies the vehicle; at most 16 vehicles, those that hover first"),
        Metric("vehicles/*/hovers", "set-points", "that command it to hover"),
        Metric("vehicles/*/refused", "observations", "not used"),
        Metric("vehicles/*/reason", "", "why it hovers now, or empty"),
        *_ADMISSION,
        _ALARMS,
    ),
}


def undeclared(role: str, values: Mapping[str, Any]) -> list[str]:
    """Return the names in a process's metrics that no declaration of its role covers."""
    declared = [metric.name.split("/") for metric in METRICS.get(role, ())]
    return [name for name in _names(values) if not any(_covers(pattern, name.split("/")) for pattern in declared)]


def _names(values: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _names(value, f"{prefix}{name}/")
        else:
            yield prefix + str(name)


def _covers(pattern: list[str], name: list[str]) -> bool:
    # Names that processes choose, those of statistics for instance, may hold a slash themselves.
    if pattern[-1] == "*" and len(name) > len(pattern):
        name = [*name[: len(pattern) - 1], "/".join(name[len(pattern) - 1 :])]
    return len(pattern) == len(name) and all(p in ("*", n) for p, n in zip(pattern, name, strict=True))
