"""Every figure that a process tells of itself in its metric messages: name, unit and meaning, by role.

Names of nested maps are joined by a slash; `*` stands for any one name. `docs/monitoring.md` is made from this table,
and a test holds it against what the processes of a real run report.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final


@dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes:
        name: where it stands in `MetricMessage.values`.
        unit: what it is counted in; empty for names, texts and plain numbers.
        meaning: what it is.
    """

    name: str
    unit: str
    meaning: str


_STEPS: Final = "environment steps"
_STATE: Final = Figure("state", "", "starting, training, draining or finished")
_ALARMS: Final = Figure("alarms", "", "sentences that somebody should read; a list")


def _account(prefix: str, whose: str) -> tuple[Figure, ...]:
    return (
        Figure(
            f"{prefix}/produced",
            _STEPS,
            f"flown by {whose}, as workers say: accepted + lost + rejected + in_flight, but for what is unexplained",
        ),
        Figure(f"{prefix}/accepted", _STEPS, "taken into replay, or on the way there inside the learner"),
        Figure(f"{prefix}/lost", _STEPS, "declared lost"),
        Figure(f"{prefix}/rejected", _STEPS, "in chunks that were refused"),
        Figure(f"{prefix}/in_flight", _STEPS, "flown after the last chunk that was taken, and not given up"),
        Figure(f"{prefix}/duplicates", "chunks", "that came again and were not taken in"),
        Figure(f"{prefix}/refused", "chunks", "that were refused"),
        Figure(f"{prefix}/aged", "chunks", "of these: refused because their policy was too old"),
        Figure(f"{prefix}/damaged", "frames", "that could not be read and were asked for again"),
    )


FIGURES: Final[dict[str, tuple[Figure, ...]]] = {
    "learner": (
        _STATE,
        Figure("episodes", "episodes", "finished"),
        Figure("episodes_total", "episodes", "lambda_max, those of the whole run"),
        Figure("environment_steps", _STEPS, "in replay's count"),
        Figure("updates", "rounds", "of updates done"),
        Figure("version", "", "parameter version; grows with every publication"),
        Figure("event", "", "imitation events applied"),
        Figure("lag_versions", "versions", "by which a chunk's policy is older than the newest, running mean"),
        Figure("queue", "chunks", "between receiver and replay"),
        Figure(
            "malformed",
            "requests",
            "of no worker that is known, of a start that was replaced, against lockstep, or with a wildcard in the key",
        ),
        Figure("malformed_commands", "requests", "that were no commands, and were refused"),
        Figure("malformed_by/*", "requests", "that brought nothing, by worker; the worst eight, the others together"),
        Figure("turned_away", "requests", "of workers that are cut off, refused without being looked at"),
        Figure("elapsed", "s", "since the run began, earlier starts included"),
        Figure(
            "waits/*",
            "s",
            "since this start, spent waiting for data, imitation, producers and checkpoint; and training",
        ),
        *_account("ledger", "all workers"),
        Figure(
            "ledger/unexplained",
            _STEPS,
            "by which accounts of workers do not close, and accepted ones neither in replay nor on the way to it; "
            "0 but for a defect",
        ),
        *_account("ledgers/*", "one worker, over all its starts; of at most 16, the others in `(others)`"),
        Figure(
            "ledgers/*/unexplained",
            _STEPS,
            "produced - accepted - lost - rejected - in_flight: above 0 forgotten, below 0 booked twice",
        ),
        Figure("ledgers/*/workers", "workers", "that `(others)` sums"),
        Figure(
            "imitations",
            "",
            "the newest four events; a list of maps: event, episode (when it was due), version, "
            "rate (theta), elites (index by type), scores (omega of each agent by type), evaluation_steps",
        ),
        Figure("curves/reward/*", "reward", "mean per agent over the newest 40 episodes: all agents, and each type"),
        Figure("curves/steps", "steps", "length of an episode, over the same"),
        Figure(
            "curves/*",
            "",
            "what else an episode came to, over the same: aoi, vdf (units), collisions, boundary "
            "(UAV steps), energy_j (J) on the farm",
        ),
        Figure("statistics/*", "", "running means of the training; docs/understanding.md says what each is"),
        Figure("evaluation_steps", _STEPS, "flown without noise for imitation"),
        Figure("checkpoints/*", "", "figures of the checkpoints; docs/understanding.md"),
        _ALARMS,
    ),
    "rollout": (
        _STATE,
        Figure("environment_steps", _STEPS, "flown since this start"),
        Figure("produced", _STEPS, "the same: accepted + rejected + in_flight, by the worker's own account"),
        Figure("accepted", _STEPS, "that the learner has acknowledged"),
        Figure("rejected", _STEPS, "in chunks that the learner refused"),
        Figure("in_flight", _STEPS, "flown and not yet answered for"),
        Figure("retries", "requests", "that had to be repeated"),
        Figure("spooled", "chunks", "that are held until they are answered"),
        Figure("simulating_seconds", "s", "spent flying"),
        Figure("waiting_seconds", "s", "spent waiting for room in the spool or for parameters"),
        Figure("evaluations", "episodes", "flown without noise for imitation"),
        Figure("epoch", "", "start of the learner that its actors are of"),
        Figure("version", "", "parameter version of its actors"),
        Figure("event", "", "imitation events in its actors"),
        Figure("stale", "messages", "with parameters or events that were not newer, and so not applied"),
        Figure("missed", "messages", "with parameters that were overtaken or lost"),
        Figure("malformed", "messages", "that were dropped"),
        Figure("paused", "", "why it does not fly, or empty"),
        Figure("paused_seconds", "s", "not flown for that reason"),
        Figure("watchers", "", "who watch its farm now"),
        Figure("shown", _STEPS, "that were published to them"),
        Figure("skipped", _STEPS, "flown while somebody watched, and not shown"),
        _ALARMS,
    ),
    "elite": (
        Figure("workers", "", "names of the workers that it can ask; a list"),
        Figure("events", "", "imitation events that the learner has applied"),
        Figure("next_episode", "episodes", "at which the next event falls due; 0 for none"),
        Figure("failures", "requests", "for evaluations that were not answered in time"),
        Figure("malformed", "messages", "and tokens that were dropped"),
        Figure("leads", "", "whether it holds the learner's lease"),
        Figure("rate", "", "theta of the newest event that it held"),
        Figure("elites/*", "", "index of that event's elite inside each type"),
        Figure("scores", "", "omega of each agent then; a list for each type"),
    ),
    "flight": (
        Figure("period_seconds", "s", "between two set-points"),
        Figure("periods", "periods", "begun"),
        Figure("overruns", "periods", "left out because the one before took too long"),
        Figure("decisions", "set-points", "that an actor decided"),
        Figure("hovers", "set-points", "that command hover"),
        Figure("refused", "observations", "that were not used: malformed, not finite, stale, not newer"),
        Figure("missed", "observations", "that never came, by the gaps in their numbers"),
        Figure(
            "latency/*",
            "ms",
            "from taking an observation in to its set-point, over the newest 1,000: median, p99, most",
        ),
        Figure("age/*", "ms", "of the observation when its set-point was made, by both clocks, likewise"),
        Figure("vehicles/*/agent", "", "the agent that flies it; of at most 16 vehicles, those that hover first"),
        Figure("vehicles/*/hovers", "set-points", "that command it to hover"),
        Figure("vehicles/*/refused", "observations", "of it that were not used"),
        Figure("vehicles/*/reason", "", "why it hovers now, or empty"),
        _ALARMS,
    ),
}


def undeclared(role: str, values: Mapping[str, Any]) -> list[str]:
    """Return the names in a process's figures that no declaration of its role covers."""
    declared = [figure.name.split("/") for figure in FIGURES.get(role, ())]
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
