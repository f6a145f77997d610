"""The targets of this project, each beside the committed result."""

import math
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any, Final

import numpy as np

from research.studies.analysis.evidence import early_farms
from research.studies.analysis.verdicts import Triple, shown
from research.studies.methods import TUNED_PRESET
from research.studies.scales import FIRST_FARM, FIRST_REPORTED

Results = Mapping[str, Any]

FACTOR: Final = 1.10
"""Times the best heuristic's reward that the learned policies should earn."""
SUPPLY: Final = 1700.0
"""Bound of the reward per agent at 4 + 4 + 4 from what sensors and plots supply in an episode, rounded; the bound of
`research.experiments.bound`, which counts more of what cannot be had, is lower."""
SHARE: Final = 0.75
"""Share of the supply bound that the learned policies should earn."""
SOONER: Final = 10.0
"""Times sooner that a part of the lawnmower's reward should be reached."""
PARTS: Final = (0.5, 0.75, 0.9, 1.0)
"""Parts of the lawnmower's reward; the target is the last one."""
OURS: Final = "EIA-SEC"
SHIPPED: Final = "the policy that ships"
SEEDS: Final = "the preset `eia-sec`, seeds of `default`"
ABSENT: Final = "not measured"
HEAD: Final = ("| target | of | needed | reached | verdict |", "|---|---|---|---|---|")


def block(flown: Results | None, seeds: Results | None, reach: Results | None, longer: Results | None = None) -> str:
    """Return the table of targets.

    Args:
        flown: research/results/heuristics/results.json: heuristics and the policy that ships, farms 1000..1099.
        seeds: the results of the study `default` at full scale.
        reach: research/results/reach/results.json: seconds until parts of the lawnmower's reward.
        longer: research/results/reach/longer/results.json: the same, with more time for peers. It decides about the
            whole.
    """
    rows = [*_rewards(flown, seeds), *_counters(flown, seeds), *_sooner(reach, longer)]
    met = sum(row[-1] == "met" for row in rows)
    lines = ["| " + " | ".join([*row[:-1], f"**{row[-1]}**"]) + " |" for row in rows]
    return "\n".join([f"{met} of {len(rows)} met.", "", *HEAD, *lines, ""])


def judged(reached: Triple, needed: float) -> str:
    """Return whether a number is as large as it should be; only when its whole interval is."""
    return "met" if reached[1] >= needed else "not met"


def _rewards(flown: Results | None, seeds: Results | None) -> list[list[str]]:
    """Return the rows of reward: against the best heuristic, and against the supply bound."""
    factor = f"at least {FACTOR:.2f} times the best heuristic's mean reward per agent, farms {FIRST_FARM}..1099"
    supply = f"at least {SHARE} of the supply bound, {SUPPLY:.0f} (a sharper one: method.md)"
    found: dict[str, tuple[str, float, Triple] | None] = {SHIPPED: None, SEEDS: None}
    notes: dict[str, str] = {}
    if flown is not None:
        rewards = {result["policy"]: result for result in flown["results"]}
        own = rewards.pop("trained:instant")
        best = max(rewards, key=lambda name: rewards[name]["reward"][0])
        found[SHIPPED] = (best, rewards[best]["reward"][0], own["reward"])
        notes[SHIPPED] = f"; {_late(own):.0f} on {FIRST_REPORTED}..{flown['last_farm']}"
    if seeds is not None:
        policies, name = seeds["references"]["policies"], seeds["references"]["best"]
        level = policies[name].get("mean_reward", policies[name]["reward"])
        found[SEEDS] = (name, level, seeds["methods"][TUNED_PRESET]["mean_reward"])
        farms = "" if early_farms(seeds) else f"; on farms from {seeds['sizes']['first_farm']} on"
        notes[SEEDS] = f", {len(seeds['methods'][TUNED_PRESET]['runs'])} seeds{farms}"
    rows = []
    for target in (factor, supply):
        for who, known in found.items():
            if known is None:
                rows.append([target, who, "", "", ABSENT])
                continue
            name, level, reward = known
            needed = FACTOR * level if target == factor else SHARE * SUPPLY
            asked = f"{needed:.0f}" + (f" ({name} {level:.0f})" if target == factor else "")
            rows.append([target, who, asked, shown(reward) + notes[who], judged(reward, needed)])
    return rows


def _late(result: Results) -> float:
    """Return a policy's mean reward on the farms that the preset was not chosen on."""
    return float(np.mean(result["per_farm"][FIRST_REPORTED - FIRST_FARM :]))


def _counters(flown: Results | None, seeds: Results | None) -> list[list[str]]:
    """Return the rows of AoI and VDF, which should be below every heuristic's."""
    rows = []
    for figure, name in (("aoi", "AoI"), ("vdf", "VDF")):
        target = f"mean {name} below every heuristic's"
        if flown is None:
            rows.append([target, SHIPPED, "", "", ABSENT])
        else:
            others = {result["policy"]: result[figure] for result in flown["results"]}
            rows.append([target, SHIPPED, *_below(others.pop("trained:instant"), others)])
        if seeds is None:
            rows.append([target, SEEDS, "", "", ABSENT])
        else:
            policies = seeds["references"]["policies"]
            levels = {policy: [found["metrics"][figure]] * 3 for policy, found in policies.items()}
            rows.append([target, SEEDS, *_below(seeds["methods"][TUNED_PRESET]["metrics"][figure], levels)])
    return rows


def _below(own: Triple, others: Mapping[str, Triple]) -> list[str]:
    """Return what is needed to be below all others, what was reached, and whether that is so."""
    least = min(others, key=lambda name: others[name][0])
    bar = others[least]
    return [f"below {shown(bar, 2)} ({least})", shown(own, 2), "met" if own[2] < bar[1] else "not met"]


def _sooner(reach: Results | None, longer: Results | None) -> list[list[str]]:
    """Return the rows of time: how much later than ours each other program earns a part of the lawnmower's reward."""
    name = "{:.0%} of the lawnmower's reward at least " + f"{SOONER:g} times sooner"
    if reach is None:
        return [[name.format(part), OURS, "", "", ABSENT] for part in PARTS]
    rows = []
    peers = [software for software in dict.fromkeys(run["software"] for run in reach["runs"]) if software != OURS]
    for part in PARTS:
        runs = reach if longer is None or part < 1.0 else longer
        own = _times(runs, OURS, part)
        for peer in peers:
            theirs = _times(runs, peer, part)
            found, verdict = _compared(own, theirs)
            fresh = ", before it learns" if _fresh(runs, part) else ""
            rows.append([name.format(part), f"than {peer}", f"{SOONER:g} times", found + fresh, verdict])
    return rows


def _fresh(reach: Results, part: float) -> bool:
    """Return whether fresh actors of ours earn a part of the lawnmower's reward in all seeds."""
    first = [run["points"][0] for run in reach["runs"] if run["software"] == OURS]
    return all(point["steps"] == 0 and point["reward"] >= part * reach["bar"] for point in first)


def _times(reach: Results, software: str, part: float) -> list[tuple[float, bool]]:
    """Return for each seed of a program the seconds until it earned a part, or for how long it was tried in vain."""
    found = []
    for run in reach["runs"]:
        if run["software"] == software:
            at = [point["seconds"] for point in run["points"] if point["reward"] >= part * reach["bar"]]
            found.append((at[0], True) if at else (run["points"][-1]["seconds"], False))
    return found


def _compared(own: Sequence[tuple[float, bool]], theirs: Sequence[tuple[float, bool]]) -> list[str]:
    """Return what was reached, and whether that is enough; a peer that was ended too early is later than that.

    The medians are times, and the range over all pairs of seeds; that whole range decides.
    """
    seeds = f"{len(own)} seed{'s' if len(own) > 1 else ''}"
    mine, late = ([seconds for seconds, _ in times] for times in (own, theirs))
    if not all(there for _, there in own):
        return [f"ours not within {max(mine):.0f} s; {seeds}", "not met"]
    middle, in_vain = median(late), [seconds for seconds, there in theirs if not there]
    least, most = min(late) / max(mine), math.inf if in_vain else max(late) / min(mine)
    between = f" ({least:.1f}..{'' if in_vain else f'{most:.1f}'})" if max(len(own), len(theirs)) > 1 else ""
    more = "more than " if in_vain and min(in_vain) <= middle else ""
    times = f"{more}{middle / median(mine):.1f} times{between}, ours in {median(mine):.0f} s"
    return [f"{times}; {seeds}", "met" if least >= SOONER else "not met" if most < SOONER else "undecided"]
