"""The table of teams that fly with inertia, on a page of its own and in docs/reference/environment.md."""

from typing import Any, Final

from eia_sec.rollout.heuristics.registry import TASKS
from research.pages.blocks import table, wrapped
from research.pages.interval_tables import COLUMNS, DECIMALS, ranked

UNTRAINED: Final = "untrained"
"""Name of the team with which training begins."""
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
    seeds = [result for result in data["results"] if "seed" in result]
    bar = next((result for result in ranked(data) if result["policy"] in TASKS), None)
    if seeds and bar:
        mean = sum(result["reward"][0] for result in seeds) / len(seeds)
        minutes = max(result["training_cpu_seconds"] for result in seeds) / 60.0
        ratio = mean / bar["reward"][0]
        number = "one seed" if len(seeds) == 1 else f"mean of {len(seeds)} seeds"
        met = "met" if ratio >= AIM and minutes <= AIM_MINUTES else "not met"
        text = f"""Trained teams ({number}) earn {ratio:.2f} times what the best heuristic, {bar["policy"]}, does, after
            at most {minutes:.0f} minutes of processor time. The aim, {AIM:g} times within {AIM_MINUTES:g} minutes, is
            {met}."""
        base = next((result for result in data["results"] if result["policy"] == UNTRAINED), None)
        if base:
            half = "less" if base["reward"][0] < 0.5 * mean else "not less"
            text += f" The untrained team earns {base['reward'][0]:.0f}, {half} than half of what they do."
        parts += [wrapped(text), ""]
    return "\n".join(parts)


def _label(result: dict[str, Any]) -> str:
    """Return a policy's name in the table."""
    return f"**trained, {result['policy']}**" if "seed" in result else str(result["policy"])


def _cell(result: dict[str, Any], name: str) -> str:
    """Return mean and interval of a field; of the reward alone with the interval."""
    digits = DECIMALS.get(name, 0)
    mean, low, high = (f"{value:.{digits}f}" for value in result[name])
    return f"{mean} ({low}..{high})" if name == "reward" and low != high else mean
