"""What the paper claims with its figures and numbers, each beside our results."""

import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from common.team import COLLECTION, COMMUNICATION, MONITORING
from deploy.studies.methods import CANDIDATES, MIXTURE
from deploy.studies.paper import (
    CONVERGED_EPISODES,
    INFERENCE_BY_METHOD,
    INFERENCE_BY_UAVS,
    REWARD,
    REWARD_BY_MEMBERS,
    REWARD_BY_UAVS,
)
from deploy.studies.verdicts import NEAR_TIME, Row, above, alike, best_of, judged, lower, shown

Results = Mapping[str, Any]

FIRST: Final = "EIA-SEC"
PEERS: Final = ("MADDPG", "MATD3", "MASAC")
PARTS: Final = ("EIA only", "SEC only", "neither")
SIMILAR: Final = 0.1
"""Peers' normalised scores within this count as similar."""
STABLE: Final = 0.1
"""A range of rewards within this share of their mean counts as stable; the paper's own is 0.045."""
MUCH: Final = 1.25
"""Times MADDPG's time from which on EIA-SEC takes much longer; the paper calls 1.17 of it no significant increase."""
ENOUGH: Final = 0.12
"""Share of a step that deciding may take; the paper's largest number is 0.117 of one."""
WHOLE: Final = 0.9
"""A type that was over this share of the field's cells has patrolled all of it."""
COMPARED: Final = "Q less realised return at the end of training, in units of the preset's targets"


def training(data: Results | None) -> list[Row]:
    """Return M1, M2 and M3."""
    claims = (
        "Reward (fig. a): EIA-SEC is far above MADDPG, MATD3 and MASAC",
        "Reward: MADDPG, MATD3 and MASAC are alike",
        "AoI (fig. b): EIA-SEC is the lowest",
        "VDF (fig. c): EIA-SEC is the lowest",
        f"M2: every method converges within {CONVERGED_EPISODES} episodes",
        "M2: EIA-SEC converges first",
        "M3: EIA-SEC is the steadiest",
        f"EIA-SEC earns {REWARD} per agent with 12 UAVs",
    )
    if data is None:
        return [Row(claim) for claim in claims]
    methods = data["methods"]
    best = data["references"]["policies"][data["references"]["best"]]["reward"]
    farm = f"their farm's constants are not printed; the best heuristic earns {best:.0f} on ours"
    return [
        *_rewards(data, claims[0], claims[1]),
        _figure(claims[2], "aoi", methods),
        _figure(claims[3], "vdf", methods),
        *_convergence(methods, claims[4], claims[5]),
        _steadiness(claims[6], methods),
        Row(claims[7], shown(methods[FIRST]["reward"]), "cannot be told", farm),
    ]


def _rewards(data: Results, far: str, similar: str) -> list[Row]:
    """Return the rows of reward: EIA-SEC against each peer, and the peers among themselves."""
    methods, better = data["methods"], {name: data["improvement"][name] for name in PEERS}
    rewards = _listed({name: shown(method["reward"]) for name, method in methods.items()})
    chance = _listed({name: shown(probability, 2) for name, probability in better.items()})
    scores = [methods[name]["normalised"][0] for name in PEERS]
    apart = max(scores) - min(scores)
    verdict = judged([above(probability) for probability in better.values()])
    return [
        Row(far, rewards, verdict, f"P(EIA-SEC is better): {chance}"),
        Row(similar, rewards, judged([apart <= SIMILAR]), f"{apart:.2f} apart, normalised; {SIMILAR} counts as alike"),
    ]


def _convergence(methods: Results, within: str, first: str) -> list[Row]:
    """Return the rows of convergence: every method's in time, and EIA-SEC's before the others'."""
    converged = {name: _converged(method) for name, method in methods.items()}
    told = _listed(_episodes(converged))
    in_time = judged([_all_within(method) for method in methods.values()])
    sooner = judged([_sooner(converged[FIRST], converged[name]) for name in PEERS])
    return [
        Row(within, told, in_time, "medians of the seeds; a method is in time when all its seeds are"),
        Row(first, told, sooner, "medians of the seeds"),
    ]


def _steadiness(claim: str, methods: Results) -> Row:
    """Return the row of stability: spread over the last episodes, and over unseen farms."""
    unrest = {name: mean_unrest(method) for name, method in methods.items()}
    farms = {name: method["farm_spread"] for name, method in methods.items()}
    answers = [spread[FIRST] < spread[name] for spread in (unrest, farms) for name in PEERS]
    told = [_listed({name: f"{value:.0f}" for name, value in spread.items()}) for spread in (unrest, farms)]
    return Row(claim, f"over the last episodes: {told[0]}", judged(answers), f"over unseen farms: {told[1]}")


def heuristics(data: Results | None, flown: Results | None) -> list[Row]:
    """Return what the paper says of policies that learn nothing.

    Args:
        data: the results of `training`.
        flown: docs/results/heuristics/results.json, which stands in for them, with the policy that ships.
    """
    claim = "Heuristics fail in this task"
    if data is not None:
        references = data["references"]
        best, learnt = references["policies"][references["best"]]["reward"], data["methods"][FIRST]["mean_reward"]
        name, what = references["best"], f"{FIRST} {shown(learnt)}"
    elif flown is not None:
        rewards = {result["policy"]: result["reward"] for result in flown["results"]}
        learnt = rewards.pop("trained")
        name = max(rewards, key=lambda policy: rewards[policy][0])
        best, what = rewards[name][0], f"the policy that ships {shown(learnt)}"
    else:
        return [Row(claim)]
    beaten = learnt[1] > best
    why = "learning beats them, but they do not fail" if beaten else "no learned policy of ours beats the best one"
    return [Row(claim, f"{name} {best:.0f}, {what}", "holds in part" if beaten else "does not hold", why)]


def ablation(data: Results | None) -> list[Row]:
    """Return the ablation of EIA and SEC."""
    claims = (
        "Ablation: both parts together are the best",
        "Ablation: without both it is the worst",
        "Ablation: EIA and SEC make learning faster",
        "SEC mitigates overestimation",
    )
    if data is None:
        return [Row(claim) for claim in claims]
    methods = {name: data["methods"][name] for name in (FIRST, *PARTS)}
    rewards = _listed({name: shown(method["reward"]) for name, method in methods.items()})
    chance = _listed({name: shown(data["improvement"][name], 2) for name in PARTS})
    without = methods["neither"]["reward"]
    worst = [lower(without, method["reward"]) for name, method in methods.items() if name != "neither"]
    converged = {name: _converged(method) for name, method in methods.items()}
    faster = [None if converged[n] == converged["neither"] else converged[n] < converged["neither"] for n in converged][
        :3
    ]
    over = {name: _overestimated(data, name) for name in ("SEC only", "neither")}
    told = _listed({name: f"{value:.2f}" for name, value in over.items()})
    less = None if math.isnan(sum(over.values())) else over["SEC only"] < over["neither"]
    return [
        Row(claims[0], rewards, judged([above(data["improvement"][name]) for name in PARTS]), f"P(better): {chance}"),
        Row(claims[1], rewards, judged(worst), "by the intervals"),
        Row(claims[2], _listed(_episodes(converged)), judged(faster), "episodes until converged, median of the seeds"),
        Row(claims[3], told, judged([less]), f"{COMPARED}; {_compared_value(methods['SEC only'])}"),
    ]


def members(data: Results | None) -> list[Row]:
    """Return k_s: that two are best, and each number against that of two."""
    rewards = {} if data is None else {name.rpartition(" ")[2]: m["reward"] for name, m in data["methods"].items()}
    claim = "k_s = 2 is the best"
    rows = [Row(claim)]
    if rewards:
        told = _listed({f"k_s = {k}": shown(reward) for k, reward in rewards.items()})
        rows = [Row(claim, told, best_of(rewards, "2"), "by the intervals")]
    for k, paper in REWARD_BY_MEMBERS.items():
        ours = rewards.get(str(k))
        rows.append(_relative(f"k_s = {k}: {paper}", paper / REWARD_BY_MEMBERS[2], ours, rewards.get("2"), "k_s = 2"))
    return rows


SHARED: Final = "what the farm's sensors and plots supply does not grow with the team that shares it"


def scalability(data: Results | None) -> list[Row]:
    """Return M4's rewards: that they hardly change, and each number against that of 12 UAVs."""
    teams = {} if data is None else {uavs: team["reward"] for uavs, team in data["teams"].items()}
    claim, rows = "M4: the reward hardly depends on the number of UAVs, 6 to 24", []
    if all(str(uavs) in teams for uavs in REWARD_BY_UAVS):
        values = [teams[str(uavs)][0] for uavs in REWARD_BY_UAVS]
        apart = (max(values) - min(values)) / abs(float(np.mean(values)))
        told = _listed({uavs: shown(reward) for uavs, reward in teams.items()})
        why = f"range {apart:.0%} of the mean; {SHARED}"
        rows = [Row(claim, told, "holds" if apart <= STABLE else "does not hold", why)]
    else:
        rows = [Row(claim)]
    for uavs, paper in REWARD_BY_UAVS.items():
        ours, base = teams.get(str(uavs)), teams.get("12")
        rows.append(_relative(f"Reward with {uavs} UAVs: {paper}", paper / REWARD_BY_UAVS[12], ours, base, "12 UAVs"))
    return rows


def inference(data: Results | None) -> list[Row]:
    """Return M4's and M5's times: how they grow, how methods differ, and each number against that of its base."""
    teams, methods = ({}, {}) if data is None else (data["teams"], data["methods"])
    claims = _times(teams, methods)
    sizes = [
        _time(f"{uavs} UAVs: {ms} ms", ms / INFERENCE_BY_UAVS[12], teams, str(uavs), "12")
        for uavs, ms in INFERENCE_BY_UAVS.items()
    ]
    named = [
        _time(f"{name}: {ms} ms", ms / INFERENCE_BY_METHOD[FIRST], methods, name, FIRST)
        for name, ms in INFERENCE_BY_METHOD.items()
    ]
    return [*claims, *sizes, *named]


def _times(teams: Results, methods: Results) -> list[Row]:
    """Return the rows of what the paper says about times."""
    claims = (
        "M4: the time grows with the number of UAVs",
        f"M4: it stays far below the time of a step (at most {ENOUGH:.0%} of 1 s)",
        "M5: all methods take time of the same order",
        "M5: MADDPG is the fastest",
        "M5: EIA-SEC takes not much longer",
    )
    if not teams:
        return [Row(claim) for claim in claims]
    sizes = sorted(map(int, teams))
    ordered, each = [teams[str(uavs)]["decide"] for uavs in sizes], {n: t["decide"] for n, t in methods.items()}
    grows = [later > earlier for earlier, later in itertools.pairwise(ordered)]
    told = _listed({str(uavs): f"{ms:.3f}" for uavs, ms in zip(sizes, ordered, strict=True)}) + " ms"
    named = _listed({name: f"{ms:.3f}" for name, ms in each.items()}) + " ms"
    slowest, others = teams[str(sizes[-1])]["separate"], [ms for name, ms in each.items() if name != "MADDPG"]
    gap, paper = each[FIRST] / each["MADDPG"], INFERENCE_BY_METHOD[FIRST] / INFERENCE_BY_METHOD["MADDPG"]
    same = "flying needs the actors alone, and those are alike in all four"
    return [
        Row(claims[0], told, judged(grows), "all actors stacked, one thread"),
        Row(claims[1], f"{slowest:.2f} ms", judged([slowest < 1e3 * ENOUGH]), f"{sizes[-1]} UAVs, one after another"),
        Row(claims[2], named, judged([max(each.values()) < 10.0 * min(each.values())]), same),
        Row(claims[3], named, judged([each["MADDPG"] < 0.95 * min(others)]), f"{same}; within 5 % counts as equal"),
        Row(claims[4], f"{gap:.2f} times MADDPG", judged([gap < MUCH]), f"{paper:.2f} times in the paper"),
    ]


def trajectories(data: Results | None) -> list[Row]:
    """Return what the paper says of paths."""
    claims = (
        "Paths: monitoring and data collection UAVs patrol the whole field",
        "Paths: theirs are more regular than those of communication UAVs",
    )
    if data is None:
        return [Row(claim) for claim in claims]
    flown = [flights[FIRST] for flights in data["farms"].values()]
    kinds = (COMMUNICATION, MONITORING, COLLECTION)
    visited, order = (
        {kind: float(np.mean([flight[name][kind] for flight in flown])) for kind in kinds}
        for name in ("visited", "order")
    )
    workers = (MONITORING, COLLECTION)
    return [
        Row(
            claims[0],
            _listed({kind: f"{visited[kind]:.0%}" for kind in workers}),
            judged([visited[kind] >= WHOLE for kind in workers]),
            f"cells of the field flown over; {WHOLE:.0%} counts as all",
        ),
        Row(
            claims[1],
            _listed({kind: f"{order[kind]:.2f}" for kind in kinds}),
            "cannot be told",
            "order of the headings; the paper does not say what regular is, and nobody can read it off one number",
        ),
    ]


CLAIMS: Final[Mapping[str, Callable[[Results | None], list[Row]]]] = {
    "training": training,
    "ablation": ablation,
    "ensemble": members,
    "scalability": scalability,
    "inference": inference,
    "trajectories": trajectories,
}
"""The claims that each study bears on."""


def _figure(claim: str, name: str, methods: Results) -> Row:
    """Return the row for a figure that is better when lower."""
    values = {method: found["figures"][name] for method, found in methods.items()}
    answers = [lower(values[FIRST], values[peer]) for peer in PEERS]
    return Row(claim, _listed({m: shown(v, 2) for m, v in values.items()}), judged(answers), "by the intervals")


def _relative(claim: str, paper: float, ours: Any, base: Any, what: str) -> Row:
    """Return the row of a number whose ratio to another one is compared."""
    if ours is None or base is None:
        return Row(claim)
    if ours is base:
        return Row(claim, shown(ours), "cannot be told", "the other numbers stand beside it; their farm is not known")
    if base[0] <= 0.0 or ours[0] <= 0.0:
        return Row(claim, shown(ours), "cannot be told", f"there is no ratio of {ours[0]:.0f} to {base[0]:.0f}")
    ratio = ours[0] / base[0]
    return Row(claim, shown(ours), alike(paper, ratio), f"{ratio:.2f} of that of {what}, the paper's {paper:.2f}")


def _time(claim: str, paper: float, times: Results, name: str, base: str) -> Row:
    if name not in times:
        return Row(claim)
    own, other = times[name], times[base]
    ratio = own["decide"] / other["decide"]
    apart = own["separate"] / other["separate"]
    told = f"{own['decide']:.3f} ms; {own['separate']:.3f} ms one network after another"
    if name == base:
        return Row(claim, told, "cannot be told", "the other numbers stand beside it; their machine is not known")
    return Row(
        claim,
        told,
        alike(paper, ratio, NEAR_TIME),
        f"{ratio:.2f} and {apart:.2f} of that of {base}, the paper's {paper:.2f}",
    )


def _listed(numbers: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in numbers.items())


def _converged(method: Results) -> float:
    """Return the median over the seeds of the episode from which on a method has converged; infinite if none."""
    return float(np.median([_episode(run) for run in method["runs"]]))


def _sooner(episode: float, other: float) -> bool | None:
    return None if episode == other else episode < other


def _all_within(method: Results) -> bool | None:
    """Return whether all seeds converge in the paper's time, or none does, or it is open."""
    within = [_episode(run) <= CONVERGED_EPISODES for run in method["runs"]]
    return True if all(within) else None if any(within) else False


def _episode(run: Results) -> float:
    return math.inf if run["converged"] is None or run["diverged"] else float(run["converged"])


def _episodes(converged: Mapping[str, float]) -> dict[str, str]:
    return {name: f"{value:.0f}" if math.isfinite(value) else "never" for name, value in converged.items()}


def mean_unrest(method: Results) -> float:
    """Return the mean of the seeds' unrest; infinite for a method of which no run got far enough to have one."""
    values = [run["unrest"] for run in method["runs"] if run["unrest"] is not None]
    return float(np.mean(values)) if values else math.inf


def _overestimated(data: Results, name: str) -> float:
    """Return by how much a method's critics overestimate, mean over types and seeds; NaN where nobody knows.

    It is in the units of the preset's targets: a method's own come with the reward scale that was chosen for it.
    """
    values = [value for run in data["methods"][name]["runs"] for value in run["overestimation"].values()]
    scale = CANDIDATES[data["choice"][name]["chosen"]].get("reward_scale", 1.0)
    return float(np.mean(values)) / scale if values else math.nan


def _compared_value(method: Results) -> str:
    """Return whose value was compared with the realised returns of a method with a shared ensemble critic."""
    if all(run.get("compared_value") == MIXTURE for run in method["runs"]):
        return "with SEC, Q is the mixture Q_P"
    return "with SEC, Q was here the local critic's Q_i and not the mixture Q_P"
