"""The table of teams that fly with inertia, on a page of its own and in docs/reference/environment.md."""

from typing import Any, Final

from eia_sec.rollout.heuristics.registry import TASKS
from research.pages.blocks import table, wrapped
from research.pages.interval_tables import COLUMNS, DECIMALS, ranked

UNTRAINED: Final = "untrained"
"""Name of the team with which training begins."""
FORESIGHT: Final = "foresight"
"""Name of the search that knows everything to come, see `research.experiments.foresight`."""
ALGORITHM_LABELS: Final = {"eia-ppo": "EIA-SEC", "ippo": "IPPO", "mappo": "MAPPO"}
"""What algorithms are called in the tables."""
AIM: Final = 1.05
"""What trained teams should earn, over the best heuristic's reward."""
AIM_MINUTES: Final = 40.0
"""Minutes of processor time in which they should: twenty on each of two cores."""
FIELDS: Final = {name: heading for name, heading in COLUMNS.items() if name not in ("energy_j", "collisions")}
"""Shown fields of a score and their headings."""


def page(data: dict[str, Any]) -> str:
    """Return the results as a page."""
    commands = dict.fromkeys(f"- `{result['command']}`, commit {result['commit']}" for result in data["results"])
    return "\n".join(["# Flight with inertia", "", inertia_block(data), "Made by:", "", *commands, ""])


def inertia_block(data: dict[str, Any]) -> str:
    """Return the table of all policies, the best first, and what it says about the aims."""
    rows = [[_label(one), *(_cell(one, name) for name in FIELDS), str(one["farms"])] for one in ranked(data)]
    parts = [table(["policy", *FIELDS.values(), "farms"], rows), ""]
    bar = next((result for result in ranked(data) if result["policy"] in TASKS), None)
    base = next((result for result in data["results"] if result["policy"] == UNTRAINED), None)
    for label, seeds in _by_algorithm(data).items():
        if not bar:
            break
        mean, minutes = mean_of(seeds, "reward"), _minutes(seeds)
        ratio = mean / bar["reward"][0]
        met = "met" if ratio >= AIM and minutes <= AIM_MINUTES else "not met"
        text = f"""{label} ({_number(seeds)}) earns {ratio:.2f} times what the best heuristic, {bar["policy"]}, does,
            after at most {minutes:.0f} minutes of processor time. The aim, {AIM:g} times within {AIM_MINUTES:g}
            minutes, is {met}."""
        if base:
            half = "less" if base["reward"][0] < 0.5 * mean else "not less"
            text += f" The untrained team earns {base['reward'][0]:.0f}, {half} than half of that."
        parts += [wrapped(text), ""]
    best = next((result for result in data["results"] if result["policy"] == FORESIGHT), None)
    if bar and best:
        ratio = best["reward"][0] / bar["reward"][0]
        text = f"""{FORESIGHT} is no policy: in every step it tries each UAV's commands on copies of the farm, with
            all random numbers to come, and the policy that ships flies on from there
            (`research/experiments/foresight.py`). It earns {ratio:.2f} times what {bar["policy"]} does."""
        parts += [wrapped(text), ""]
    return "\n".join(parts)


def readme_block(data: dict[str, Any]) -> str:
    """Return the short table of README.md: teams that learned, heuristics, an untrained team, the best first."""
    rows = [(f"{result['policy']}, heuristic", result) for result in ranked(data) if result["policy"] in TASKS]
    rows += [("untrained team", result) for result in data["results"] if result["policy"] == UNTRAINED]
    trained = _by_algorithm(data)
    for label, seeds in trained.items():
        means = {name: [mean_of(seeds, name)] * 3 for name in ("reward", "aoi", "vdf")}
        rows.append((f"**{label}, preset `inertial`**", seeds[0] if len(seeds) == 1 else means))
    rows.sort(key=lambda row: -row[1]["reward"][0])
    cells = [[name, *(_cell(result, key) for key in ("reward", "aoi", "vdf"))] for name, result in rows]
    costs = "; ".join(f"{label}: {_number(seeds)}, {_minutes(seeds):.0f} minutes" for label, seeds in trained.items())
    text = f"""Mean reward without noise on farms on which nothing was chosen, with a 95 % interval over the farms
        ({costs} of processor time at most). UAVs need time to change their velocity, by PX4's limits. Teams learned
        from nothing: no route, no plan, no example. AoI is the mean age of sensor data, VDF that of plot images; lower
        is better."""
    return "\n".join([wrapped(text), "", table(["policy", "reward per agent", "AoI", "VDF"], cells), ""])


def _by_algorithm(data: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Return the seeds of each algorithm by its label."""
    found: dict[str, list[dict[str, Any]]] = {}
    for result in data["results"]:
        if "seed" in result:
            found.setdefault(ALGORITHM_LABELS[result["algorithm"]], []).append(result)
    return found


def _number(seeds: list[dict[str, Any]]) -> str:
    return "one seed" if len(seeds) == 1 else f"mean of {len(seeds)} seeds"


def _minutes(seeds: list[dict[str, Any]]) -> float:
    """Return the most processor time that one of the seeds took, min."""
    return float(max(result["training_cpu_seconds"] for result in seeds)) / 60.0


def mean_of(results: list[dict[str, Any]], name: str) -> float:
    """Return the mean of a field over results."""
    return float(sum(result[name][0] for result in results) / len(results))


def _label(result: dict[str, Any]) -> str:
    """Return a policy's name in the table."""
    return f"**{result['policy']}**" if "seed" in result else str(result["policy"])


def _cell(result: dict[str, Any], name: str) -> str:
    """Return mean and interval of a field; of the reward alone with the interval."""
    digits = DECIMALS.get(name, 0)
    mean, low, high = (f"{value:.{digits}f}" for value in result[name])
    return f"{mean} ({low}..{high})" if name == "reward" and low != high else mean
