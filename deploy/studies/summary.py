"""What the runs of one method came to, as the results of a study keep it."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from deploy.studies.bench import TWELVE, Bench
from deploy.studies.jobs import Job
from deploy.studies.methods import CANDIDATES, Method
from deploy.studies.scales import TRIAL_SEED
from deploy.studies.statistics import (
    Interval,
    Numbers,
    convergence,
    final_value,
    improvement_interval,
    interval,
    mean,
    normalised,
    spread,
    unrest,
)

DIGITS: Final = 4


def method_summary(bench: Bench, runs: Sequence[Job], uavs: int = TWELVE) -> dict[str, Any]:
    """Return the statistics of a method's runs over seeds and unseen farms, its curves, and every run's origin."""
    records = [bench.records.get(run) for run in runs]
    results = [record["result"] for record in records if record is not None]
    random, best, _ = bench.ends(uavs)
    reward = bench.scores(list(runs))
    types = results[0]["evaluation"]["types"]
    figures = results[0]["evaluation"]["figures"]
    return {
        "normalised": told(interval(normalised(reward, random, best))),
        "reward": told(interval(reward)),
        "mean_reward": told(interval(reward, mean)),
        "types": {name: told(interval(_stacked(results, "types", name))) for name in types},
        "figures": {name: told(interval(_stacked(results, "figures", name))) for name in figures},
        "farm_spread": round(spread(reward), DIGITS),
        "runs": [_run(run, record) for run, record in zip(runs, records, strict=True) if record is not None],
    }


def reference_summary(bench: Bench, uavs: int = TWELVE) -> dict[str, Any]:
    """Return the means of every policy that learns nothing, and which heuristic is the best."""
    random, best, name = bench.ends(uavs)
    policies = {}
    for job in bench.references(uavs):
        result = bench.records.result(job)
        reward = np.array(result["reward"])
        policies[str(job.options["policy"])] = {
            "reward": round(float(reward.mean()), DIGITS),
            "normalised": round(float(normalised(reward, random, best).mean()), DIGITS),
            "types": {kind: round(float(np.mean(values)), DIGITS) for kind, values in result["types"].items()},
            "figures": {kind: round(float(np.mean(values)), DIGITS) for kind, values in result["figures"].items()},
            "job": job.digest,
        }
    return {"best": name, "policies": policies}


def choice_summary(bench: Bench, methods: Sequence[Method]) -> dict[str, Any]:
    """Return what each trial of each method came to, which settings were chosen, and what made the trials."""
    names = list(CANDIDATES)[: bench.scale.candidates]
    found: dict[str, Any] = {}
    for method in methods:
        jobs = bench.trials(method)
        rewards = bench.scores(jobs).mean(axis=1)
        trials = {name: round(float(reward), DIGITS) for name, reward in zip(names, rewards, strict=True)}
        records = [bench.records.get(job) for job in jobs]
        commits = sorted({str(record["commit"]) for record in records if record is not None})
        found[method.name] = {"chosen": bench.choice(method), "trials": trials, "seed": TRIAL_SEED, "commits": commits}
    return found


def comparisons(bench: Bench, first: Sequence[Job], others: dict[str, list[Job]]) -> dict[str, list[float]]:
    """Return the probability that a run of the first method is above one of each other on the same farm."""
    own = bench.scores(list(first))
    return {name: told(improvement_interval(own, bench.scores(runs))) for name, runs in others.items()}


def told(found: Interval) -> list[float]:
    """Return an interval as JSON keeps it."""
    return [round(number, DIGITS) for number in found]


def _stacked(results: Sequence[dict[str, Any]], section: str, name: str) -> Numbers:
    return np.array([result["evaluation"][section][name] for result in results], np.float64)


def _run(job: Job, record: dict[str, Any]) -> dict[str, Any]:
    """Return a run as it stands in the results: origin, counters, end, curve, convergence and unrest."""
    result = record["result"]
    curve = result["curve"]
    reward = curve["reward"]["mean"]  # empty when it diverged before its first episode was over
    return {
        "label": job.label,
        **{name: record[name] for name in ("job", "config", "seed", "commit", "command", "seconds")},
        **{name: result[name] for name in ("episodes", "environment_steps", "evaluation_steps", "updates", "events")},
        "diverged": result["diverged"],
        "reward": round(float(np.mean(result["evaluation"]["reward"])), DIGITS),
        "training_reward": round(final_value(reward), DIGITS) if reward else None,
        "converged": convergence(curve["episodes"], reward) if reward else None,
        "unrest": round(unrest(reward), DIGITS) if reward else None,
        "overestimation": result.get("overestimation", {}),
        "realised_return": result.get("realised_return", {}),
        "compared_value": result.get("compared_value"),
        "curve": curve,
        "checks": result["checks"],
    }
