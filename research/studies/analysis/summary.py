"""Summaries of the runs of one method, as the results of a study keep them."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from eia_sec.deploy.reports.intervals import Interval, Numbers, interquartile_mean
from research.studies.analysis.evidence import SIGNS
from research.studies.analysis.statistics import (
    convergence,
    final_value,
    improvement_interval,
    interval,
    mean,
    normalised,
    spread,
    unrest,
)
from research.studies.bench import TWELVE, Bench
from research.studies.jobs import Job
from research.studies.methods import CANDIDATES, Method
from research.studies.scales import TRIAL_SEED

DIGITS: Final = 4


def method_summary(bench: Bench, runs: Sequence[Job], uavs: int = TWELVE) -> dict[str, Any]:
    """Return the statistics of a method's runs over seeds and unseen farms, its curves, and every run's origin."""
    records = [bench.records.get(run) for run in runs]
    evaluations = bench.evaluations(runs)
    random, best, _ = bench.ends(uavs)
    reward = bench.scores(runs)
    types, names = evaluations[0]["types"], evaluations[0]["metrics"]
    return {
        "normalised": bounds(interval(normalised(reward, random, best))),
        "reward": bounds(interval(reward)),
        "mean_reward": bounds(interval(reward, mean)),
        "types": {name: bounds(interval(_stacked(evaluations, "types", name))) for name in types},
        "metrics": {name: bounds(interval(_stacked(evaluations, "metrics", name))) for name in names},
        "farm_spread": round(spread(reward), DIGITS),
        "runs": [
            _run(run, record, evaluation)
            for run, record, evaluation in zip(runs, records, evaluations, strict=True)
            if record is not None
        ],
    }


def reference_summary(bench: Bench, uavs: int = TWELVE) -> dict[str, Any]:
    """Return interquartile means over the farms of every policy that learns nothing, and which heuristic is the best.

    The statistic is that of the methods, which have several seeds; such a policy has one row of farms. Its plain mean
    stands beside.
    """
    random, best, name = bench.ends(uavs)
    policies, jobs = {}, bench.references(uavs)
    for job, evaluation in zip(jobs, bench.evaluations(jobs), strict=True):
        record, reward = bench.records.get(job), np.array(evaluation["reward"])
        assert record is not None, "asked for before it was done"
        policies[str(job.options["policy"])] = {
            "reward": _middle(reward),
            "mean_reward": round(float(reward.mean()), DIGITS),
            "normalised": _middle(normalised(reward, random, best)),
            "types": {kind: _middle(values) for kind, values in evaluation["types"].items()},
            "metrics": {kind: _middle(values) for kind, values in evaluation["metrics"].items()},
            "job": job.digest,
            "commit": record["commit"],
        }
    return {"best": name, "policies": policies}


def choice_summary(bench: Bench, methods: Sequence[Method]) -> dict[str, Any]:
    """Return the score of each trial of each method, the chosen settings, and where the trials come from."""
    names = list(CANDIDATES)[: bench.scale.candidates]
    found: dict[str, Any] = {}
    for method in methods:
        rewards = bench.trial_rewards(method)
        trials = {name: round(reward, DIGITS) for name, reward in zip(names, rewards, strict=True)}
        records = [bench.records.get(job) for job in bench.trials(method)]
        commits = sorted({str(record["commit"]) for record in records if record is not None})
        found[method.name] = {"chosen": bench.choice(method), "trials": trials, "seed": TRIAL_SEED, "commits": commits}
    return found


def comparisons(bench: Bench, runs: Mapping[str, Sequence[Job]]) -> dict[str, Any]:
    """Return the probability that a run of one method is better than one of another on the same farm.

    Args:
        bench: the records.
        runs: the runs of each method, by its name.

    Returns:
        `improvement`: of the first method over each other, by reward. `pairs`: by each of SIGNS, of each method over
        every one that comes after it; less AoI and less VDF are better.
    """
    evaluations = {name: bench.evaluations(own) for name, own in runs.items()}
    pairs: dict[str, dict[str, dict[str, list[float]]]] = {}
    for figure, sign in SIGNS.items():
        scores = {name: sign * _figure(own, figure) for name, own in evaluations.items()}
        found: dict[str, dict[str, list[float]]] = {}
        for one, other in itertools.combinations(scores, 2):
            found.setdefault(one, {})[other] = bounds(improvement_interval(scores[one], scores[other]))
        pairs[figure] = found
    first = next(iter(runs))
    return {"improvement": pairs["reward"].get(first, {}), "pairs": pairs}


def times_summary(seeds: Sequence[Mapping[str, Any]], commits: Sequence[str]) -> dict[str, Any]:
    """Return the summary of the timings of several seeds, ms.

    Args:
        seeds: for each seed what `timing.time_decisions` found.
        commits: what made them.

    Returns:
        For each piece the median of the seeds' medians, under its own name; under `q95` the largest of the seeds' 95 %
        quantiles; and every seed's times.
    """
    pieces = ("decide", "separate", "simulate")
    return {
        **{piece: round(float(np.median([seed[piece]["median"] for seed in seeds])), 5) for piece in pieces},
        "q95": {piece: max(seed[piece]["q95"] for seed in seeds) for piece in pieces},
        "seeds": list(seeds),
        "commits": sorted(commits),
    }


def bounds(found: Interval) -> list[float]:
    """Return an interval as JSON keeps it."""
    return [round(number, DIGITS) for number in found]


def _stacked(evaluations: Sequence[Mapping[str, Any]], section: str, name: str) -> Numbers:
    return np.array([evaluation[section][name] for evaluation in evaluations], np.float64)


def _figure(evaluations: Sequence[Mapping[str, Any]], name: str) -> Numbers:
    """Return [runs, farms] of one of SIGNS."""
    if name == "reward":
        return np.array([evaluation["reward"] for evaluation in evaluations], np.float64)
    return _stacked(evaluations, "metrics", name)


def _middle(values: Any) -> float:
    """Return the interquartile mean over farms of one policy's scores."""
    return round(float(interquartile_mean(np.array(values, np.float64)[None])), DIGITS)


def _run(job: Job, record: dict[str, Any], evaluation: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run as it stands in the results: origin, counters, end, curve, convergence and unrest."""
    result = record["result"]
    curve = result["curve"]
    reward = curve["reward"]["mean"]  # empty when it diverged before its first episode was over
    return {
        "label": job.label,
        **{name: record[name] for name in ("job", "config", "seed", "commit", "command", "seconds")},
        **{name: result[name] for name in ("episodes", "environment_steps", "evaluation_steps", "updates", "events")},
        "diverged": result["diverged"],
        "reward": round(float(np.mean(evaluation["reward"])), DIGITS),
        "metrics": {name: round(float(np.mean(values)), DIGITS) for name, values in evaluation["metrics"].items()},
        "farm_spread": round(spread(np.array(evaluation["reward"])), DIGITS),
        "training_reward": round(final_value(reward), DIGITS) if reward else None,
        "converged": convergence(curve["episodes"], reward) if reward else None,
        "unrest": round(unrest(reward), DIGITS) if reward else None,
        "overestimation": result.get("overestimation", {}),
        "reward_scale": job.config.algorithm.reward_scale,
        "realised_return": result.get("realised_return", {}),
        "compared_value": result.get("compared_value"),
        "curve": curve,
        "checks": result["checks"],
    }
