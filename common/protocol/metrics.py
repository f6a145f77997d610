"""Every metric that a process publishes about itself: name, unit, meaning and name in TensorBoard, by role.

Names of nested maps are joined by a slash; `*` stands for any one name. A test
holds the table against what the processes of a real run report, and `docs/reference/monitoring.md` is made from it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final


@dataclass(frozen=True)
class Metric:
    """One metric.

    Attributes:
        name: where it stands in `MetricMessage.values`.
        unit: what it is counted in; empty for names, texts and plain numbers.
        meaning: what it is.
        scalar: its name in TensorBoard, in trackers and for callbacks; empty if they do not show it. Names are those of
            CleanRL where it has one; what only we count is in the group `eia_sec`.
    """

    name: str
    unit: str
    meaning: str
    scalar: str = ""


_STEPS: Final = "environment steps"
_STATE: Final = Metric("state", "", "training, draining or finished; of a worker also starting")
_ADMISSION: Final = (
    Metric("descriptors", "", "open file descriptors, of a process that listens; half of the limit raises an alarm"),
    Metric(
        "waiting_connections",
        "",
        "connections whose peer hung up before they were accepted; each delays new members by 0.1 s",
    ),
)
EPISODIC_RETURN: Final = "charts/episodic_return"
MEAN_REWARD: Final = "eval/mean_reward"
_ALARMS: Final = Metric("alarms", "", "list of sentences that need a person's attention")


def _account(prefix: str, whose: str, scalars: str = "") -> tuple[Metric, ...]:
    """Return the metrics of an account of steps; with their names in TensorBoard below `scalars`, if given."""
    metrics = (
        Metric(
            f"{prefix}/produced",
            _STEPS,
            f"simulated by {whose}, as workers report it: accepted + lost + rejected + in_flight + unexplained",
        ),
        Metric(f"{prefix}/accepted", _STEPS, "accepted: in replay, or on the way there inside the learner"),
        Metric(f"{prefix}/lost", _STEPS, "steps that can no longer arrive"),
        Metric(f"{prefix}/claimed", _STEPS, "lost steps of chunks that a worker says it skipped; no record shows them"),
        Metric(f"{prefix}/rejected", _STEPS, "steps of refused chunks"),
        Metric(
            f"{prefix}/in_flight", _STEPS, "steps produced after the last chunk that the learner took, and not lost"
        ),
        Metric(f"{prefix}/duplicates", "chunks", "chunks received again and ignored"),
        Metric(f"{prefix}/refused", "chunks", "chunks refused"),
        Metric(f"{prefix}/aged", "chunks", "refused chunks whose policy was too old"),
        Metric(f"{prefix}/damaged", "frames", "unreadable frames, requested again"),
    )
    return tuple(replace(m, scalar=m.name.replace(prefix, scalars, 1)) if scalars else m for m in metrics)


_LOSSES: Final = (
    ("actor_loss", "policy_loss", "", "PPO's surrogate loss with the entropy bonus, by type of agent"),
    ("value_loss", "value_loss", "", "mean squared error of the value functions, by type"),
    ("entropy", "entropy", "nats", "mean entropy of the policies, by type"),
    ("kl", "approx_kl", "nats", "KL divergence of the updates, by type"),
    ("clipped_share", "clipfrac", "", "share of samples whose ratio was clipped, by type"),
    ("explained_variance", "explained_variance", "", "share of the returns' variance that values predict, by type"),
    ("critic_loss", "qf1_loss", "", "mean squared TD error of the (first) critic, by type"),
    ("q_mean", "qf1_values", "", "mean Q of the batch's actions, by type"),
    ("temperature", "alpha", "", "MASAC's weight of entropy, by type"),
)
"""Diagnostics that CleanRL has too: our name, its name, unit, meaning."""

METRICS: Final[dict[str, tuple[Metric, ...]]] = {
    "learner": (
        _STATE,
        Metric("episodes", "episodes", "training episodes finished"),
        Metric("episodes_total", "episodes", "training episodes of the whole run, lambda_max; 0 where steps end it"),
        Metric("steps_total", _STEPS, "training steps of the whole run; 0 where episodes end it"),
        Metric("progress", "", "finished share of the run, 0 to 1"),
        Metric("environment_steps", _STEPS, "steps added to replay"),
        Metric("updates", "updates", "gradient updates done"),
        Metric("version", "", "parameter version; grows with every publication"),
        Metric("event", "", "imitation events applied"),
        Metric(
            "steps_per_second",
            "1/s",
            "environment_steps divided by elapsed: the mean over the whole run",
            "charts/SPS",
        ),
        Metric(
            "lag_versions",
            "versions",
            "age of a chunk's policy when it arrives, running mean",
            "eia_sec/lag_versions",
        ),
        Metric("queue", "chunks", "chunks waiting between receiver and replay", "eia_sec/queue"),
        Metric(
            "malformed",
            "requests",
            "invalid requests: from unknown workers, against the rules of lockstep, or with a wildcard in the key",
        ),
        Metric("replaced", "requests", "requests from a worker's start that a newer start has replaced"),
        Metric(
            "arguments",
            "",
            "arguments that a callback or a command has given to the run's environments, JSON, or empty",
        ),
        Metric("stopped", "", "why a callback of a plug-in stopped the run, or empty"),
        Metric("malformed_commands", "requests", "requests that were no valid commands and were refused"),
        Metric("imitations_refused", "requests", "requests to imitate that schedule, team or lease exclude"),
        Metric("round", "", "newest round of the population that it took part in; of a run alone there is none"),
        Metric("hyperparameters/*", "", "with which a member of a population now learns"),
        Metric("rounds_refused", "requests", "rounds of a population that the configuration or the lease exclude"),
        Metric(
            "malformed_by/*",
            "requests",
            "invalid requests of one worker; the eight with the most, and the sum of the others",
        ),
        Metric("turned_away", "requests", "requests refused unread because their worker is blocked"),
        Metric(
            "uncounted_episodes",
            "episodes",
            "episodes not counted because this learner has not received all their steps",
        ),
        Metric("flights_given_up", "chunks", "chunks that others no longer waited for, because nobody delivered"),
        *_ADMISSION,
        Metric("elapsed", "s", "time since the run began, without the pauses between its starts"),
        Metric(
            "waits/*",
            "s",
            "time since this start: the learner waits for data, imitation and checkpoint, and trains; producers, which "
            "overlaps these, is the time in which workers had to wait",
            "eia_sec/waits/*",
        ),
        Metric("group/learners", "learners", "learners that make the updates together"),
        Metric(
            "group/exchange_seconds",
            "s",
            "part of training: time in which the leader exchanges rows and gradients and waits for slower learners",
        ),
        *_account("ledger", "all workers", "eia_sec/ledger"),
        Metric(
            "ledger/unexplained",
            _STEPS,
            "steps by which the workers' accounts do not add up, plus accepted steps that are neither in replay nor on "
            "the way to it; 0 unless there is a defect",
            "eia_sec/ledger/unexplained",
        ),
        *_account("ledgers/*", "one worker in all its starts (16 workers at most; `(others)` sums the rest)"),
        Metric(
            "ledgers/*/unexplained",
            _STEPS,
            "produced - accepted - lost - rejected - in_flight: above 0 if forgotten, below 0 if counted twice",
        ),
        Metric("ledgers/*/workers", "workers", "number of workers in `(others)`"),
        Metric(
            "imitations",
            "",
            "list of the newest four events, each a map: event, episode (when it was due), version, "
            "rate (vartheta), elites (index by type), scores (omega of each agent by type), evaluation_steps",
        ),
        Metric(
            "exploits",
            "",
            "list of the newest four rounds of a population, each a map: round, scores (by member), sources (whom each "
            "type imitates), rate, hyperparameters, before (those until then), evaluation_steps, and counters",
        ),
        Metric(
            "curves/reward/mean",
            "reward",
            "mean reward per agent and episode over the newest 40 episodes",
            EPISODIC_RETURN,
        ),
        Metric("curves/reward/*", "reward", "the same of each type of agent", f"{EPISODIC_RETURN}_*"),
        Metric("curves/steps", "steps", "mean length of the same episodes", "charts/episodic_length"),
        Metric(
            "curves/infos/*",
            "",
            "means of the numbers in a PettingZoo environment's infos over the same episodes",
            "charts/infos/*",
        ),
        Metric("curves/*", "", "means of the environment's episode metrics over the same episodes", "charts/*"),
        Metric(
            "environment/*",
            "",
            "labels for views: short_names of types of agents, and episode_metrics, a list of maps with name, unit, "
            "meaning, label, digits, factor, plotted, group",
        ),
        Metric("statistics/learning_rate", "", "step size of the actors' optimiser", "charts/learning_rate"),
        *(
            Metric(f"statistics/{name}/*", unit, meaning, f"losses/{scalar}_*")
            for name, scalar, unit, meaning in _LOSSES
        ),
        Metric(
            "statistics/*",
            "",
            "further running means of training diagnostics; docs/how-to/debug_training.md explains each",
            "eia_sec/*",
        ),
        Metric("evaluation_steps", _STEPS, "steps of noise-free evaluation for imitation"),
        Metric(
            "checkpoints/*",
            "",
            "sizes and times of checkpoints; docs/how-to/debug_training.md",
            "eia_sec/checkpoints/*",
        ),
        _ALARMS,
    ),
    "rollout": (
        _STATE,
        Metric("environment_steps", _STEPS, "steps simulated since this start"),
        Metric("produced", _STEPS, "steps of whole chunks: accepted + rejected + in_flight, by the worker's own count"),
        Metric("accepted", _STEPS, "steps acknowledged by the learner"),
        Metric("rejected", _STEPS, "steps of chunks that the learner refused"),
        Metric("in_flight", _STEPS, "steps produced and not yet acknowledged or refused"),
        Metric("left_behind", _STEPS, "those of them in an unfinished chunk that nobody takes; docs/how-to/resume.md"),
        Metric("retries", "requests", "requests sent again"),
        Metric("spooled", "chunks", "chunks held until the learner answers"),
        Metric("simulating_seconds", "s", "time spent simulating"),
        Metric("waiting_seconds", "s", "time spent waiting for room in the spool or for parameters"),
        Metric("evaluations", "episodes", "noise-free episodes that the coordinator asked for"),
        Metric("epoch", "", "epoch of the learner that its actors came from"),
        Metric("version", "", "parameter version of its actors"),
        Metric("event", "", "imitation events applied to its actors"),
        Metric("stale", "messages", "messages ignored because their parameters or event were not newer"),
        Metric("missed", "messages", "parameter messages lost on the way"),
        Metric("malformed", "messages", "unreadable messages, dropped"),
        Metric("paused", "", "why its actors are too old to simulate with, or empty"),
        Metric("paused_seconds", "s", "time for which its actors were too old"),
        Metric("outages", "", "times that an environment's simulator or robot went away"),
        Metric("steps_resent", "", "requests to a served environment that were sent again"),
        Metric("answers_refused", "", "answers of served environments that could not be used or were a refusal"),
        Metric(
            "step_timeouts",
            "",
            "times that the worker was replaced, as its environment did not return from a call",
        ),
        Metric("watchers", "", "number of watchers now"),
        Metric("shown", _STEPS, "steps published to watchers"),
        Metric("skipped", _STEPS, "steps simulated while somebody watched, but not published"),
        Metric("pictures", "", "pictures that an environment's `render()` has drawn for watchers"),
        Metric("no_pictures", "", "why it draws none, or empty"),
        _ALARMS,
    ),
    "elite": (
        Metric("workers", "", "list of the workers that can evaluate"),
        Metric("events", "", "imitation events that the learner has applied"),
        Metric("next_episode", "episodes", "episode at which the next event is due; 0 if there is none"),
        Metric("shared", "", "whether the agents of a type still share their actors, so that no event is due"),
        Metric("failures", "requests", "evaluation requests refused, answered wrongly or not in time"),
        Metric("malformed", "messages", "unreadable messages and tokens, dropped"),
        Metric("rounds_missed", "rounds", "rounds of its population that were held without the learner"),
        Metric("leads", "", "whether it holds the learner's lease"),
        Metric("rate", "", "blend factor vartheta of the newest event"),
        Metric("elites/*", "", "index inside each type of the agent that now scores best"),
        Metric("scores/*", "", "omega of each agent of a type, by its rewards in training; a list"),
        Metric(
            "noise_free/reward",
            "reward",
            "mean reward per agent and episode without noise, on the first 4 evaluation farms; not outside the farm",
        ),
        Metric("noise_free/number", "evaluations", "evaluations of this kind so far, about one a minute"),
        _ALARMS,
    ),
    "flight": (
        Metric("period_seconds", "s", "time between two set-points"),
        Metric("periods", "periods", "periods started"),
        Metric("overruns", "periods", "periods skipped because the one before took too long"),
        Metric("steps", _STEPS, "steps of the farm that its map has taken over"),
        Metric("served", "visits", "photographs and packets that vehicles have reported"),
        Metric("decisions", "set-points", "set-points of the policy"),
        Metric("limited", "set-points", "of these, those that the field's border limits"),
        Metric("hovers", "set-points", "set-points that command hover"),
        Metric(
            "causes/*",
            "set-points",
            "those by cause: missing, late, doubled, field, jump, height, sensors, lost, policy, end",
        ),
        Metric("refused", "poses", "poses not used: malformed, for another agent, not newer, or of another time"),
        Metric("misreported", "visits", "reports of plots or sensors that do not exist, or from the future"),
        Metric("missed", "poses", "poses that never arrived, by the gaps in their numbers"),
        Metric("jumps", "poses", "poses farther from the one before than a vehicle flies"),
        Metric("standing_by", "", "vehicles that obey another flight node"),
        Metric(
            "latency/*",
            "ms",
            "time from a pose's arrival to the set-point after it: median, p99 and maximum of the newest 1,000",
        ),
        Metric("age/*", "ms", "age of the pose when its set-point was made, by both clocks; likewise"),
        Metric("recorded", "messages", "messages in the flight's record, with `--record`"),
        Metric("unrecorded", "messages", "messages that came after the record had ended, likewise"),
        Metric("vehicles/*/agent", "", "the agent that flies the vehicle; of at most 16 vehicles, hovering ones first"),
        Metric("vehicles/*/hovers", "set-points", "set-points that command it to hover"),
        Metric("vehicles/*/refused", "poses", "poses not used"),
        Metric("vehicles/*/reason", "", "why it hovers now, or empty"),
        Metric("vehicles/*/obeys", "", "the flight node that it obeys, or empty"),
        *_ADMISSION,
        _ALARMS,
    ),
}


def scalars(values: Mapping[str, Any], types: Sequence[str]) -> dict[str, float]:
    """Return the numbers that TensorBoard, trackers and callbacks show, by their names there.

    Args:
        values: metrics of the learner or of the evaluation, or a part of them.
        types: the team's types of agents; names of a team with one type do not name it.
    """
    found: dict[str, float] = {}
    for name, value in flattened(values).items():
        metric = _of_learner(name)
        if metric is not None and metric.scalar:
            own = "/".join(name.split("/")[metric.name.count("/") :])
            scalar = metric.scalar.removesuffix("_*") if len(types) == 1 else metric.scalar
            found[scalar.replace("*", own)] = value
    return found


@lru_cache(maxsize=4096)  # every report asks for the same names again
def _of_learner(name: str) -> Metric | None:
    parts = name.split("/")
    return next((m for m in (*METRICS["learner"], *EVALUATION) if _covers(m.name.split("/"), parts)), None)


def flattened(values: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    """Return the numbers in nested mappings by their names, joined with slashes; skip other values."""
    result: dict[str, float] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            result |= flattened(value, f"{prefix}{name}/")
        elif isinstance(value, int | float):
            result[prefix + name] = float(value)
    return result


EVALUATION: Final = (
    Metric(
        "evaluation/reward",
        "reward",
        "mean reward per agent and episode of the final policy, without noise, in scenarios that training never saw",
        MEAN_REWARD,
    ),
    Metric("evaluation/types/*", "reward", "the same of each type of agent", f"{MEAN_REWARD}_*"),
    Metric("evaluation/steps", "steps", "mean length of the same episodes", "eval/mean_ep_length"),
    Metric("evaluation/*", "", "means of the environment's episode metrics over the same episodes", "eval/*"),
)
"""What `eia-sec train` measures at a run's end."""


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
