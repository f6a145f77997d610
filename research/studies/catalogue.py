"""The studies: which jobs each consists of, and what its results are made from."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from research.studies.analysis.summary import (
    choice_summary,
    comparisons,
    method_summary,
    reference_summary,
    times_summary,
)
from research.studies.bench import TWELVE, Bench
from research.studies.flights import flight_summary
from research.studies.jobs import Job
from research.studies.methods import (
    ABLATIONS,
    EIA_SEC,
    OBSERVATIONS,
    ON_POLICY,
    PEERS,
    TRAINED,
    TUNED_PRESET,
    Method,
)

Stages = list[list[Job]]
"""Jobs in the order in which they can be done: which runs a later stage consists of follows from the earlier ones."""


@dataclass(frozen=True)
class Study:
    """One study.

    Attributes:
        title: what it shows.
        stages: returns its jobs.
        summarise: returns its results once all jobs are done.
        flies: whether that takes the policies of its runs, and not their records alone.
    """

    title: str
    stages: Callable[[Bench], Stages]
    summarise: Callable[[Bench], dict[str, Any]]
    flies: bool = False


def _compared(bench: Bench, methods: tuple[Method, ...], seeds: int) -> Stages:
    """Return trials and runs of methods that are each tuned by themselves."""
    trials = [trial for method in methods for trial in bench.trials(method)]
    # Seed by seed, so that a study that is cut off has as many seeds of each method.
    by_seed = zip(*(bench.runs(method, seeds) for method in methods), strict=True)
    return [trials, [*bench.references(), *(run for runs in by_seed for run in runs)]]


def _comparison(bench: Bench, methods: tuple[Method, ...], seeds: int) -> dict[str, Any]:
    return _compared_runs(bench, methods, {method.name: bench.runs(method, seeds) for method in methods})


def _compared_runs(bench: Bench, tuned: tuple[Method, ...], runs: Mapping[str, list[Job]]) -> dict[str, Any]:
    """Return the summaries of runs by name, and how the methods that were tuned here were tuned."""
    return {
        "references": reference_summary(bench),
        "choice": choice_summary(bench, tuned),
        "methods": {name: method_summary(bench, own) for name, own in runs.items()},
        **comparisons(bench, runs),
    }


def _member_methods(bench: Bench) -> dict[int, Method]:
    return {k: Method(f"k_s = {k}", {**EIA_SEC.changes, "algorithm.ensemble_members": k}) for k in bench.scale.members}


def _ensemble_stages(bench: Bench) -> Stages:
    runs = [
        run
        for method in _member_methods(bench).values()
        for run in bench.runs(method, bench.scale.side_seeds, tuned_as=EIA_SEC)
    ]
    return [bench.trials(EIA_SEC), [*bench.references(), *runs]]


def _ensemble(bench: Bench) -> dict[str, Any]:
    runs = {
        method.name: bench.runs(method, bench.scale.side_seeds, tuned_as=EIA_SEC)
        for method in _member_methods(bench).values()
    }
    return {
        "references": reference_summary(bench),
        "choice": choice_summary(bench, [EIA_SEC]),
        "methods": {name: method_summary(bench, own) for name, own in runs.items()},
        "pairs": comparisons(bench, runs)["pairs"],
    }


def _scalability_stages(bench: Bench) -> Stages:
    jobs: list[Job] = []
    for uavs in bench.scale.uavs:
        jobs += bench.references(uavs) + bench.timing(EIA_SEC, uavs)
        jobs += bench.runs(EIA_SEC, bench.scale.team_seeds, uavs=uavs)
    return [bench.trials(EIA_SEC), jobs]


def _scalability(bench: Bench) -> dict[str, Any]:
    teams: dict[str, Any] = {}
    for uavs in bench.scale.uavs:
        runs = bench.runs(EIA_SEC, bench.scale.team_seeds, uavs=uavs)
        teams[str(uavs)] = {
            "references": reference_summary(bench, uavs),
            "time": _times(bench, EIA_SEC, uavs),
            **method_summary(bench, runs, uavs),
        }
    return {"choice": choice_summary(bench, [EIA_SEC]), "teams": teams}


def _inference_stages(bench: Bench) -> Stages:
    sizes = [bench.timing(EIA_SEC, uavs) for uavs in bench.scale.timed_uavs]
    methods = [bench.timing(method, TWELVE) for method in PEERS]
    # Seed by seed, so that what else the machine does for a while does not fall on one size or method alone.
    return [[job for seed in zip(*sizes, *methods, strict=True) for job in seed]]


def _inference(bench: Bench) -> dict[str, Any]:
    return {
        "teams": {str(uavs): _times(bench, EIA_SEC, uavs) for uavs in bench.scale.timed_uavs},
        "methods": {method.name: _times(bench, method, TWELVE) for method in (EIA_SEC, *PEERS)},
        "untrained": True,
    }


def _times(bench: Bench, method: Method, uavs: int) -> dict[str, Any]:
    """Return the times of a method's decisions; see `times_summary`."""
    records = [(job, bench.records.get(job)) for job in bench.timing(method, uavs)]
    results = [{"seed": job.config.seed, **record["result"]} for job, record in records if record is not None]
    return times_summary(results, list({record["commit"] for _, record in records if record is not None}))


def _trajectory_stages(bench: Bench) -> Stages:
    return [bench.trials(EIA_SEC), [*bench.references(), *bench.runs(EIA_SEC, 1)]]


def _default_stages(bench: Bench) -> Stages:
    runs = zip(bench.preset_runs(bench.scale.seeds), bench.runs(EIA_SEC, bench.scale.seeds), strict=True)
    return [bench.trials(EIA_SEC), [*bench.references(), *(run for both in runs for run in both)]]


def _default(bench: Bench) -> dict[str, Any]:
    seeds = bench.scale.seeds
    runs = {TUNED_PRESET: bench.preset_runs(seeds), EIA_SEC.name: bench.runs(EIA_SEC, seeds)}
    return _compared_runs(bench, (EIA_SEC,), runs)


def _on_policy_stages(bench: Bench, methods: tuple[Method, ...], seeds: int) -> Stages:
    by_seed = zip(*(bench.on_policy_runs(method, seeds) for method in methods), strict=True)
    return [[*bench.references(), *(run for runs in by_seed for run in runs)]]


def _on_policy(bench: Bench, methods: tuple[Method, ...], seeds: int) -> dict[str, Any]:
    runs = {method.name: bench.on_policy_runs(method, seeds) for method in methods}
    return {key: value for key, value in _compared_runs(bench, (), runs).items() if key != "choice"}


STUDIES: Final[Mapping[str, Study]] = {
    "training": Study(
        "M1, M2, M3: EIA-SEC beside MADDPG, MATD3 and MASAC",
        lambda bench: _compared(bench, TRAINED, bench.scale.seeds),
        lambda bench: _comparison(bench, TRAINED, bench.scale.seeds),
    ),
    "ablation": Study(
        "Both parts, each alone, neither; and the printed target",
        lambda bench: _compared(bench, ABLATIONS, bench.scale.side_seeds),
        lambda bench: _comparison(bench, ABLATIONS, bench.scale.side_seeds),
    ),
    "ensemble": Study("Members of the shared ensemble critic, k_s", _ensemble_stages, _ensemble),
    "scalability": Study("M4: smaller and larger teams", _scalability_stages, _scalability),
    "inference": Study("M5: time of a decision", _inference_stages, _inference),
    "default": Study("The preset eia-sec beside EIA-SEC as the studies train it", _default_stages, _default),
    "on_policy": Study(
        "PPO: shared and separate networks, elite imitation and the shared ensemble",
        lambda bench: _on_policy_stages(bench, ON_POLICY, bench.scale.seeds),
        lambda bench: _on_policy(bench, ON_POLICY, bench.scale.seeds),
    ),
    "observations": Study(
        "PPO: one observation less",
        lambda bench: _on_policy_stages(bench, OBSERVATIONS, bench.scale.view_seeds),
        lambda bench: _on_policy(bench, OBSERVATIONS, bench.scale.view_seeds),
    ),
    "trajectories": Study("Where the UAVs fly, and what they collect", _trajectory_stages, flight_summary, True),
}
"""Every study by the word that names it."""
