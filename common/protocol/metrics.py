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
_ALARMS: Final = Metric("alarms", "", "sentences that somebody should read; a list")


def _account(prefix: str, whose: str) -> tuple[Metric, ...]:
    return (
        Metric(
            f"{prefix}/produced",
            _STEPS,
            f"flown by {whose}, as workers say: accepted + lost + rejected + in_flight, but for what is unexplained",
        ),
        Metric(f"{prefix}/accepted", _STEPS, "taken into replay, or on the way there inside the learner"),
        Metric(f"{prefix}/lost", _STEPS, "declared lost"),
        Metric(f"{prefix}/rejected", _STEPS, "in chunks that were refused"),
        Metric(f"{prefix}/in_flight", _STEPS, "flown after the last chunk that was taken, and not given up"),
        Metric(f"{prefix}/duplicates", "chunks", "that came again and were not taken in"),
        Metric(f"{prefix}/refused", "chunks", "that were refused"),
        Metric(f"{prefix}/aged", "chunks", "of these: refused because their policy was too old"),
        Metric(f"{prefix}/damaged", "frames", "that could not be read and were asked for again"),
    )


METRICS: Final[dict[str, tuple[Metric, ...]]] = {
    "learner": (
        _STATE,
        Metric("episodes", "episodes", "finished"),
        Metric("episodes_total", "episodes", "lambda_max, those of the whole run"),
        Metric("environment_steps", _STEPS, "in replay's count"),
        Metric("updates", "updates", "done"),
        Metric("version", "", "parameter version; grows with every publication"),
        Metric("event", "", "imitation events applied"),
        Metric("lag_versions", "versions", "by which a chunk's policy is older than the newest, running mean"),
        Metric("queue", "chunks", "between receiver and replay"),
        Metric(
            "malformed",
            "requests",
            "of no worker that is known, against lockstep, or with a wildcard in the key",
        ),
        Metric("replaced", "requests", "of a start of a worker that a newer start of it has replaced"),
        Metric("malformed_commands", "requests", "that were no commands, and were refused"),
        Metric("malformed_by/*", "requests", "that brought nothing, by worker; the worst eight, the others together"),
        Metric("turned_away", "requests", "of workers that are cut off, refused without being looked at"),
        Metric("uncounted_episodes", "episodes", "that did not count, as this learner has not seen all their steps"),
        Metric("descriptors", "", "that the process holds, where it listens; from half of its limit on an alarm"),
        Metric("waiting_connections", "", "that hung up before they were let in, and hold up new members 0.1 s each"),
        Metric("elapsed", "s", "since the run began, earlier starts included"),
        Metric(
            "waits/*",
            "s",
            "since this start, spent waiting for data, imitation, producers and checkpoint; and training",
        ),
        *_account("ledger", "all workers"),
        Metric(
            "ledger/unexplained",
            _STEPS,
            "by which accounts of workers do not close, and accepted ones neither in replay nor on the way to it; "
            "0 but for a defect",
        ),
        *_account("ledgers/*", "one worker, over all its starts; of at most 16, the others in `(others)`"),
        Metric(
            "ledgers/*/unexplained",
            _STEPS,
            "produced - accepted - lost - rejected - in_flight: above 0 forgotten, below 0 booked twice",
        ),
        Metric("ledgers/*/workers", "workers", "that `(others)` sums"),
        Metric(
            "imitations",
            "",
            "the newest four events; a list of maps: event, episode (when it was due), version, "
            "rate (theta), elites (index by type), scores (omega of each agent by type), evaluation_steps",
        ),
        Metric("curves/reward/*", "reward", "mean per agent over the newest 40 episodes: all agents, and each type"),
        Metric("curves/steps", "steps", "length of an episode, over the same"),
        Metric("curves/*", "", "the environment's episode metrics, over the same"),
        Metric(
            "environment/*",
            "",
            "labels for views: short_names of the types of agents, and episode_metrics, a list of maps: name, unit, "
            "meaning, label, digits, factor, plotted, group",
        ),
        Metric("statistics/*", "", "running means of the training; docs/how-to/debug_training.md says what each is"),
        Metric("evaluation_steps", _STEPS, "flown without noise for imitation"),
        Metric("checkpoints/*", "", "metrics of the checkpoints; docs/how-to/debug_training.md"),
        _ALARMS,
    ),
    "rollout": (
        _STATE,
        Metric("environment_steps", _STEPS, "flown since this start"),
        Metric("produced", _STEPS, "the same: accepted + rejected + in_flight, by the worker's own account"),
        Metric("accepted", _STEPS, "that the learner has acknowledged"),
        Metric("rejected", _STEPS, "in chunks that the learner refused"),
        Metric("in_flight", _STEPS, "flown and not yet answered for"),
        Metric("retries", "requests", "that had to be repeated"),
        Metric("spooled", "chunks", "that are held until they are answered"),
        Metric("simulating_seconds", "s", "spent flying"),
        Metric("waiting_seconds", "s", "spent waiting for room in the spool or for parameters"),
        Metric("evaluations", "episodes", "flown without noise for imitation"),
        Metric("epoch", "", "start of the learner that its actors are of"),
        Metric("version", "", "parameter version of its actors"),
        Metric("event", "", "imitation events in its actors"),
        Metric("stale", "messages", "with parameters or events that were not newer, and so not applied"),
        Metric("missed", "messages", "with parameters that were overtaken or lost"),
        Metric("malformed", "messages", "that were dropped"),
        Metric("paused", "", "why it does not fly, or empty"),
        Metric("paused_seconds", "s", "not flown for that reason"),
        Metric("watchers", "", "who watch its farm now"),
        Metric("shown", _STEPS, "that were published to them"),
        Metric("skipped", _STEPS, "flown while somebody watched, and not shown"),
        _ALARMS,
    ),
    "elite": (
        Metric("workers", "", "names of the workers that it can ask; a list"),
        Metric("events", "", "imitation events that the learner has applied"),
        Metric("next_episode", "episodes", "at which the next event falls due; 0 for none"),
        Metric("failures", "requests", "for evaluations that were not answered in time"),
        Metric("malformed", "messages", "and tokens that were dropped"),
        Metric("leads", "", "whether it holds the learner's lease"),
        Metric("rate", "", "theta of the newest event that it held"),
        Metric("elites/*", "", "index of that event's elite inside each type"),
        Metric("scores", "", "omega of each agent then; a list for each type"),
    ),
    "flight": (
        Metric("period_seconds", "s", "between two set-points"),
        Metric("periods", "periods", "begun"),
        Metric("overruns", "periods", "left out because the one before took too long"),
        Metric("decisions", "set-points", "that an actor decided"),
        Metric("hovers", "set-points", "that command hover"),
        Metric("refused", "observations", "that were not used: malformed, not finite, stale, not newer"),
        Metric("missed", "observations", "that never came, by the gaps in their numbers"),
        Metric(
            "latency/*",
            "ms",
            "from taking an observation in to its set-point, over the newest 1,000: median, p99, most",
        ),
        Metric("age/*", "ms", "of the observation when its set-point was made, by both clocks, likewise"),
        Metric("vehicles/*/agent", "", "the agent that flies it; of at most 16 vehicles, those that hover first"),
        Metric("vehicles/*/hovers", "set-points", "that command it to hover"),
        Metric("vehicles/*/refused", "observations", "of it that were not used"),
        Metric("vehicles/*/reason", "", "why it hovers now, or empty"),
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
