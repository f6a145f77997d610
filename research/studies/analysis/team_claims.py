"""What the paper claims of teams of several sizes, of times and of paths, each claim beside our results."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from eia_sec.common.farm import COLLECTION, COMMUNICATION, MONITORING
from research.studies.analysis.evidence import over_seeds
from research.studies.analysis.paper import INFERENCE_BY_METHOD, INFERENCE_BY_UAVS, REWARD_BY_UAVS
from research.studies.analysis.verdicts import (
    NEAR_TIME,
    Answer,
    Row,
    Triple,
    above,
    alike_throughout,
    judged,
    listed,
    ratio,
    shown,
)
from research.studies.flights import LATTICE_HEADINGS, lattice_order

Results = Mapping[str, Any]

FIRST: Final = "EIA-SEC"
STABLE: Final = 0.1
"""A range of rewards within this share of their mean counts as stable; the paper's own is 0.045."""
MUCH: Final = 1.25
"""Times MADDPG's time from which on EIA-SEC takes much longer; the paper calls 1.17 of it no significant increase."""
ENOUGH: Final = 0.12
"""Share of a step that deciding may take; the paper's largest number is 0.117 of one."""
SAME_ORDER: Final = 10.0
"""Times of the same order differ by less than this factor."""
WHOLE: Final = 0.9
"""A type that was over this share of the field's cells has patrolled all of it."""
SHARED: Final = "what the farm's sensors and plots supply does not grow with the team that shares it"
ALIKE_ACTORS: Final = "flying needs the actors alone, and those are alike in all four"


def scalability(data: Results | None) -> list[Row]:
    """Return M4's rewards: that they hardly change, and each number against that of 12 UAVs."""
    teams = {} if data is None else {uavs: team["reward"] for uavs, team in data["teams"].items()}
    claim, rows = "M4: the reward hardly depends on the number of UAVs, 6 to 24", []
    if all(str(uavs) in teams for uavs in REWARD_BY_UAVS):
        apart = _range([teams[str(uavs)] for uavs in REWARD_BY_UAVS])
        text = listed({uavs: shown(reward) for uavs, reward in teams.items()})
        answer = True if apart[2] <= STABLE else False if apart[1] > STABLE else None
        rows = [Row(claim, text, judged([answer]), f"range {apart[0]:.0%} of the mean; {SHARED}")]
    else:
        rows = [Row(claim)]
    for uavs, paper in REWARD_BY_UAVS.items():
        ours, base = teams.get(str(uavs)), teams.get("12")
        rows.append(relative(f"Reward with {uavs} UAVs: {paper}", paper / REWARD_BY_UAVS[12], ours, base, "12 UAVs"))
    return rows


def _range(numbers: Sequence[Triple]) -> Triple:
    """Return the range of numbers over their mean, and its ends when each is anywhere in its interval."""
    value, low, high = np.array(numbers, np.float64).T
    whole = abs(float(value.mean()))
    least = max(0.0, float(low.max() - high.min()))
    return float(np.ptp(value)) / whole, least / whole, float(high.max() - low.min()) / whole


def inference(data: Results | None) -> list[Row]:
    """Return M4's and M5's times: how they grow, how methods differ, and each number against that of its base."""
    teams, methods = ({}, {}) if data is None else (data["teams"], data["methods"])
    sizes = [
        _time(f"{uavs} UAVs: {ms} ms", ms / INFERENCE_BY_UAVS[12], teams, str(uavs), "12")
        for uavs, ms in INFERENCE_BY_UAVS.items()
    ]
    named = [
        _time(f"{name}: {ms} ms", ms / INFERENCE_BY_METHOD[FIRST], methods, name, FIRST)
        for name, ms in INFERENCE_BY_METHOD.items()
    ]
    return [*_growth(teams), *_methods(methods), *sizes, *named]


def _growth(teams: Results) -> list[Row]:
    """Return the rows of what the paper says about times and the number of UAVs."""
    grows = "M4: the time grows with the number of UAVs"
    enough = f"M4: it stays far below the time of a step (at most {ENOUGH:.0%} of 1 s)"
    if not teams:
        return [Row(grows), Row(enough)]
    sizes = sorted(teams, key=int)
    longer = {
        f"{more} over {less}": over_seeds(_medians(teams[more]), _medians(teams[less]))
        for less, more in itertools.pairwise(sizes)
    }
    text = listed({uavs: shown(_spread(teams[uavs], "decide"), 2) for uavs in sizes}) + " ms"
    chances = listed({pair: shown(chance, 2) for pair, chance in longer.items()})
    late = sorted(seed["separate"]["q95"] for seed in teams[sizes[-1]]["seeds"])
    where = f"95 % quantiles of the seeds, the largest counts; {sizes[-1]} UAVs, one network after another"
    return [
        Row(grows, text, judged([above(chance) for chance in longer.values()]), f"P(longer): {chances}; {_SEEDS}"),
        Row(
            enough,
            f"{shown((float(np.median(late)), late[0], late[-1]), 1)} ms",
            judged([late[-1] < 1e3 * ENOUGH]),
            where,
        ),
    ]


def _methods(methods: Results) -> list[Row]:
    """Return the rows of what the paper says about times of methods."""
    order, fastest = "M5: all methods take time of the same order", "M5: MADDPG is the fastest"
    little = "M5: EIA-SEC takes not much longer"
    if not methods:
        return [Row(order), Row(fastest), Row(little)]
    each = {name: _spread(times, "decide") for name, times in methods.items()}
    text = listed({name: shown(numbers, 2) for name, numbers in each.items()}) + " ms"
    least, most = min(numbers[1] for numbers in each.values()), max(numbers[2] for numbers in each.values())
    base = _medians(methods["MADDPG"])
    slower = {name: over_seeds(_medians(times), base) for name, times in methods.items() if name != "MADDPG"}
    chances = listed({name: shown(chance, 2) for name, chance in slower.items()})
    gap = ratio(each[FIRST], each["MADDPG"])
    paper = INFERENCE_BY_METHOD[FIRST] / INFERENCE_BY_METHOD["MADDPG"]
    short: Answer = True if gap[2] < MUCH else False if gap[1] >= MUCH else None
    return [
        Row(
            order,
            text,
            judged([most < SAME_ORDER * least]),
            f"the slowest seed of any within {SAME_ORDER:g} times the fastest",
        ),
        Row(fastest, text, judged([above(p) for p in slower.values()]), f"P(slower): {chances}; {ALIKE_ACTORS}"),
        Row(little, f"{shown(gap, 2)} times MADDPG", judged([short]), f"{paper:.2f} times in the paper; {_SEEDS}"),
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
    kinds, workers = (COMMUNICATION, MONITORING, COLLECTION), (MONITORING, COLLECTION)
    visited, order = (
        {kind: float(np.mean([flight[name][kind] for flight in flown])) for kind in kinds}
        for name in ("visited", "order")
    )
    return [
        Row(
            claims[0],
            listed({kind: f"{visited[kind]:.0%}" for kind in workers}),
            judged([visited[kind] >= WHOLE for kind in workers]),
            f"cells of the field flown over; {WHOLE:.0%} counts as all; one policy, {len(flown)} farms",
        ),
        Row(
            claims[1],
            listed({kind: f"{order[kind]:.2f}" for kind in kinds}),
            judged([_more_regular(flown, kind) for kind in workers]),
            "order of the headings, 1 when all steps have one; more regular when it is higher on every farm; one "
            f"policy, {len(flown)} farms; the paper does not say what it calls regular{_lattice(data)}",
        ),
    ]


def _lattice(data: Results) -> str:
    """Return what else shapes the monitors' headings."""
    if data.get("monitors_steer_by") != "lattice":
        return ""
    return (
        f". Monitors steer by a lattice of {LATTICE_HEADINGS} headings, which alone gives an order of "
        f"{lattice_order():.2f}"
    )


def _more_regular(flown: Sequence[Results], kind: str) -> Answer:
    """Return whether a type's headings are more ordered than the relays' on every farm; open when farms disagree."""
    more = [flight["order"][kind] > flight["order"][COMMUNICATION] for flight in flown]
    return True if all(more) else None if any(more) else False


def relative(claim: str, paper: float, ours: Triple | None, base: Triple | None, what: str) -> Row:
    """Return the row of a number whose ratio to another one is compared."""
    if ours is None or base is None:
        return Row(claim)
    if ours is base:
        return Row(claim, shown(ours), "undecided", "the other numbers stand beside it; their farm is not known")
    if min(ours) <= 0.0 or min(base) <= 0.0:
        return Row(claim, shown(ours), "undecided", f"there is no ratio of {ours[0]:.0f} to {base[0]:.0f}")
    found = ratio(ours, base)
    why = f"{shown(found, 2)} of that of {what}, the paper's {paper:.2f}"
    return Row(claim, shown(ours), alike_throughout(paper, found), why)


_SEEDS: Final = "medians of the seeds"


def _medians(times: Results) -> list[float]:
    """Return the median time of a decision of each seed, all actors stacked, ms."""
    return [float(seed["decide"]["median"]) for seed in times["seeds"]]


def _spread(times: Results, piece: str) -> Triple:
    """Return the median of the seeds' medians of a piece, the least and the largest of them, ms."""
    medians = [seed[piece]["median"] for seed in times["seeds"]]
    return float(np.median(medians)), min(medians), max(medians)


def _time(claim: str, paper: float, times: Results, name: str, base: str) -> Row:
    if name not in times:
        return Row(claim)
    own, apart = (_spread(times[name], piece) for piece in ("decide", "separate"))
    text = f"{shown(own, 2)} ms; {shown(apart, 2)} ms one network after another"
    if name == base:
        return Row(claim, text, "undecided", "the other numbers stand beside it; their machine is not known")
    stacked, separate = (
        ratio(_spread(times[name], piece), _spread(times[base], piece)) for piece in ("decide", "separate")
    )
    return Row(
        claim,
        text,
        alike_throughout(paper, stacked, NEAR_TIME),
        f"{shown(stacked, 2)} and {shown(separate, 2)} of that of {base}, the paper's {paper:.2f}",
    )
