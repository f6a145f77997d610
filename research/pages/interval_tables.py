"""A Markdown table of policies with confidence intervals of their means."""

from typing import Any, Final

COLUMNS: Final = {
    "reward": "reward per agent",
    "communication": "communication",
    "monitoring": "monitoring",
    "collection": "data collection",
    "aoi": "AoI",
    "vdf": "VDF",
    "energy_j": "energy, kJ",
    "collisions": "collisions",
}
"""Shown fields of a score and their headings."""
DECIMALS: Final = {"aoi": 2, "vdf": 2, "energy_j": 1, "collisions": 2}
"""Number of decimals by field; others have none."""


def interval_table(data: dict[str, Any]) -> str:
    """Return the results as Markdown, best reward first."""
    lines = ["| policy | " + " | ".join(COLUMNS.values()) + " |", "|---|" + "---:|" * len(COLUMNS)]
    for result in ranked(data):
        cells = [result["policy"]]
        for name in COLUMNS:
            scale, digits = (0.001 if name == "energy_j" else 1.0), DECIMALS.get(name, 0)
            mean, low, high = (f"{value * scale:.{digits}f}" for value in result[name])
            cells.append(mean if low == high else f"{mean} ({low}..{high})")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def ranked(data: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the results, best reward first."""
    return sorted(data["results"], key=lambda result: -result["reward"][0])
