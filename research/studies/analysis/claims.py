"""What the paper claims of methods, each claim beside our results; those about teams are in `team_claims.py`."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from research.studies.analysis.evidence import (
    ON_FARMS,
    better,
    converged,
    farm_spread,
    lead,
    mean_over_seeds,
    mean_unrest,
    over_seeds,
    overestimation,
    overestimation_of,
    rewards,
    unrest,
)
from research.studies.analysis.paper import CONVERGED_EPISODES, REWARD, REWARD_BY_MEMBERS
from research.studies.analysis.team_claims import inference, relative, scalability, trajectories
from research.studies.analysis.verdicts import FAR, SIMILAR, Row, above, best_of, far, judged, listed, shown, similar

Results = Mapping[str, Any]

FIRST: Final = "EIA-SEC"
PEERS: Final = ("MADDPG", "MATD3", "MASAC")
PARTS: Final = ("EIA only", "SEC only", "neither")
CONTROL: Final = "neither"
"""The ablation without EIA and SEC, which has critics of the agent's own observation as EIA-SEC has."""
UNLIKE: Final[Mapping[str, Callable[[Results], Any]]] = {
    "their farms": lambda sizes: (sizes.get("first_farm"), sizes["farms"]),
    "the length of late methods' trials": lambda sizes: sizes.get("long_trial_episodes", sizes["trial_episodes"]),
}
"""What may stand between two studies that are compared, by their sizes; older ones had one length of trials."""


def training(data: Results | None, control: Results | None = None) -> list[Row]:
    """Return M1, M2 and M3.

    Args:
        data: the results of `training`.
        control: those of `ablation`, which show how much remains without either part.
    """
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
    methods = {name: data["methods"][name] for name in (FIRST, *PEERS)}  # the paper has no others
    data = {**data, "methods": methods}
    best = data["references"]["policies"][data["references"]["best"]]["reward"]
    farm = f"their farm's constants are not printed; the best heuristic earns {best:.0f} on ours"
    return [
        *_rewards(data, claims[0], claims[1], _share_without(data, control)),
        _figure(claims[2], "aoi", data, control),
        _figure(claims[3], "vdf", data, control),
        *_convergence(methods, claims[4], claims[5]),
        _steadiness(claims[6], methods),
        Row(claims[7], shown(methods[FIRST]["reward"]), "undecided", farm),
    ]


def _rewards(data: Results, far_above: str, same: str, control: str) -> list[Row]:
    """Return the rows of reward: EIA-SEC against each peer, and the peers among themselves."""
    text = listed({name: shown(method["reward"]) for name, method in data["methods"].items()})
    chances = [better(data, FIRST, name)[0] for name in PEERS]
    leads = [lead(data, FIRST, name) for name in PEERS]
    pairs = [(one, other) for place, one in enumerate(PEERS) for other in PEERS[place + 1 :]]
    between = {pair: lead(data, *pair) for pair in pairs}
    answers = [similar(apart, better(data, *pair)[0]) for pair, apart in between.items()]
    ahead = listed(dict(zip(PEERS, (shown(found, 2) for found in leads), strict=True)))
    apart = listed({f"{one} less {other}": shown(found, 2) for (one, other), found in between.items()})
    return [
        Row(
            far_above,
            text,
            judged([above(chance) for chance in chances] + [far(found) for found in leads]),
            f"two claims: above, {_chances(PEERS, chances)}; and far above, normalised lead over {ahead}, of which "
            f"more than {FAR} counts as far{control}",
        ),
        Row(same, text, judged(answers), f"normalised, {apart}; alike when the interval is within {SIMILAR}"),
    ]


def _share_without(data: Results, control: Results | None) -> str:
    """Return how much of EIA-SEC's lead over the best peer is there without EIA and SEC; empty when nobody knows."""
    if control is None:
        return ""
    means = {name: float(np.mean(rewards(data["methods"][name]))) for name in (FIRST, *PEERS)}
    best = max(PEERS, key=lambda name: means[name])
    alone, whole = rewards(control["methods"][CONTROL]), means[FIRST] - means[best]
    text = (
        f". Control: `{CONTROL}` of the ablation (no EIA, no SEC, but critics of the own observation, where the peers' "
        f"are joint) earns {shown(control['methods'][CONTROL]['reward'])}"
    )
    most = max(reward for name in PEERS for reward in rewards(data["methods"][name]))
    text += ", each of its runs more than every run of the peers" if min(alone) > most else ""
    if whole <= 0.0:
        return text
    share = (float(np.mean(alone)) - means[best]) / whole
    found = f"{text}; so {share:.0%} of the lead over {best} is there without EIA and SEC"
    found += ": most of it comes with the scope of the critics" if share > 0.5 else ""
    unlike = [name for name, of in UNLIKE.items() if of(data["sizes"]) != of(control["sizes"])]
    return found + (f" (the two studies differ in {' and '.join(unlike)})" if unlike else "")


def _convergence(methods: Results, within: str, first: str) -> list[Row]:
    """Return the rows of convergence: every method's in time, and EIA-SEC's before the others'."""
    episodes = {name: converged(method) for name, method in methods.items()}
    chances = [over_seeds(episodes[name], episodes[FIRST]) for name in PEERS]
    own_end = (
        "against each curve's own end, which is within the budget, so that only a curve still rising there is late"
    )
    return [
        Row(within, _medians(episodes), judged([_all_within(found) for found in episodes.values()]), own_end),
        Row(
            first, _medians(episodes), judged([above(chance) for chance in chances]), _chances(PEERS, chances, "first")
        ),
    ]


def _steadiness(claim: str, methods: Results) -> Row:
    """Return the row of stability: spread over the last episodes, and over unseen farms."""
    restless = {name: unrest(method) for name, method in methods.items()}
    chances = [over_seeds(restless[name], restless[FIRST]) for name in PEERS]
    text = listed({name: f"{mean_unrest(method):.0f}" for name, method in methods.items()})
    farms = listed({name: f"{method['farm_spread']:.0f}" for name, method in methods.items()})
    over_farms = {name: farm_spread(method) for name, method in methods.items()}
    why, answers = _chances(PEERS, chances, "steadier"), [above(chance) for chance in chances]
    if any(found is None for found in over_farms.values()):
        answers += [None] * len(PEERS)
        why += "; over farms these results hold no seed's own spread, so that half is open"
    else:
        more = [over_seeds(over_farms[name] or [], over_farms[FIRST] or []) for name in PEERS]
        answers += [above(chance) for chance in more]
        why += f"; over farms {_chances(PEERS, more, 'steadier')}"
    return Row(claim, f"over the last episodes: {text}; over unseen farms: {farms}", judged(answers), why)


def heuristics(data: Results | None, flown: Results | None) -> list[Row]:
    """Return what the paper says of policies that learn nothing.

    Args:
        data: the results of `training`.
        flown: research/results/heuristics/results.json, which stands in for them, with the policy that ships.
    """
    claim = "Heuristics fail in this task"
    if data is not None:
        references = data["references"]
        name, learnt = references["best"], data["methods"][FIRST]["mean_reward"]
        policy, what = references["policies"][name], f"{FIRST} {shown(learnt)}"
        best = policy.get("mean_reward", policy["reward"])  # results without the one have the mean in the other
    elif flown is not None:
        results = {result["policy"]: result["reward"] for result in flown["results"]}
        learnt = results.pop("trained:instant")
        name = max(results, key=lambda policy: results[policy][0])
        best, what = results[name][0], f"the policy that ships {shown(learnt)}"
    else:
        return [Row(claim)]
    if learnt[1] <= best <= learnt[2]:
        return [Row(claim, f"{name} {best:.0f}, {what}", "undecided", "means, within the interval")]
    beaten = learnt[1] > best
    why = (
        "means; learning beats them, but they do not fail"
        if beaten
        else "means; no policy of this study beats the best one"
    )
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
    text = listed({name: shown(data["methods"][name]["reward"]) for name in (FIRST, *PARTS)})
    best = [better(data, FIRST, name) for name in PARTS]
    others = [name for name in (FIRST, *PARTS) if name != CONTROL]
    worst = [better(data, name, CONTROL) for name in others]
    episodes = {name: converged(data["methods"][name]) for name in (FIRST, *PARTS)}
    faster = [over_seeds(episodes[CONTROL], episodes[name]) for name in others]
    return [
        Row(claims[0], text, judged([above(found[0]) for found in best]), _counted(PARTS, best)),
        Row(claims[1], text, judged([above(found[0]) for found in worst]), _counted(others, worst, f"above {CONTROL}")),
        Row(claims[2], _medians(episodes), judged([above(p) for p in faster]), _chances(others, faster, "first")),
        _overestimated(claims[3], data),
    ]


def _overestimated(claim: str, data: Results) -> Row:
    """Return the row of overestimation, with and without the shared ensemble critic."""
    names = ("SEC only", CONTROL)
    over = {name: overestimation(data, name) for name in names}
    own, without = (over[name] for name in names)
    if own is None or without is None:
        return Row(claim, "not measured", "undecided", "no run text it")
    text = listed({name: shown(mean_over_seeds(values or []), 1) for name, values in over.items()})
    chance = over_seeds(without, own)
    why = (
        "Q less realised return at the end of training, in units of reward, that is divided by each method's own "
        f"reward scale; Q is {overestimation_of(data, names)}; {_chances(('SEC only',), [chance], 'lower')}"
    )
    return Row(claim, text, judged([above(chance)]), why)


def members(data: Results | None) -> list[Row]:
    """Return k_s: that two are best, and each number against that of two."""
    found = {} if data is None else {name.rpartition(" ")[2]: m["reward"] for name, m in data["methods"].items()}
    claim = "k_s = 2 is the best"
    rows = [Row(claim)]
    if data is not None:
        text = listed({f"k_s = {k}": shown(reward) for k, reward in found.items()})
        over = {k: better(data, "k_s = 2", f"k_s = {k}") for k in found if k != "2"}
        verdict = best_of(found, "2", {k: chance for k, (chance, _) in over.items()})
        rows = [
            Row(claim, text, verdict, _counted([f"k_s = {k}" for k in over], list(over.values()), "k_s = 2 better"))
        ]
    for k, paper in REWARD_BY_MEMBERS.items():
        ours = found.get(str(k))
        rows.append(relative(f"k_s = {k}: {paper}", paper / REWARD_BY_MEMBERS[2], ours, found.get("2"), "k_s = 2"))
    return rows


CLAIMS: Final[Mapping[str, Callable[[Results | None], list[Row]]]] = {
    "training": training,
    "ablation": ablation,
    "ensemble": members,
    "scalability": scalability,
    "inference": inference,
    "trajectories": trajectories,
}
"""The claims that each study bears on."""


def _figure(claim: str, name: str, data: Results, control: Results | None) -> Row:
    """Return the row for a figure that is better when lower."""
    values = {method: shown(found["metrics"][name], 2) for method, found in data["methods"].items()}
    found = [better(data, FIRST, peer, name) for peer in PEERS]
    why = _counted(PEERS, found, "lower")
    if control is not None:
        why += f"; `{CONTROL}` of the ablation has {shown(control['methods'][CONTROL]['metrics'][name], 2)}"
    return Row(claim, listed(values), judged([above(chance) for chance, _ in found]), why)


def _counted(names: Sequence[str], found: Sequence[tuple[Sequence[float], str]], what: str = "better") -> str:
    """Return probabilities of improvement by name, and what they were counted from where that is not the farms."""
    sources = sorted({source for _, source in found} - {ON_FARMS})
    return "; ".join([_chances(names, [chance for chance, _ in found], what), *sources])


def _chances(names: Sequence[str], chances: Sequence[Sequence[float]], what: str = "better") -> str:
    text = {name: shown(chance, 2) for name, chance in zip(names, chances, strict=True)}
    return f"P({what}): {listed(text)}"


def _medians(episodes: Mapping[str, Sequence[float]]) -> str:
    """Return the median over the seeds of the episode from which on each method has converged."""
    medians = {name: float(np.median(values)) for name, values in episodes.items()}
    return "medians: " + listed({name: f"{m:.0f}" if math.isfinite(m) else "never" for name, m in medians.items()})


def _all_within(episodes: Sequence[float]) -> bool | None:
    """Return whether all seeds converge in the paper's time, or none does, or it is open."""
    within = [episode <= CONVERGED_EPISODES for episode in episodes]
    return True if all(within) else None if any(within) else False
