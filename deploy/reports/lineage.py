"""The lineage of a population: who imitated whom in which round, with the members' scores and hyperparameters."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from eia_sec.deploy.reports.plots import DPI, OTHER_COLOURS


def exploits(metrics: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the rounds in a member's metrics, as `eia_sec.learner.process.metrics_log.exploit_record` writes them."""
    return [record for record in metrics if record.get("kind") == "exploit"]


def sentences(members: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[str]:
    """Return a line for each time that a member imitated, oldest first.

    Args:
        members: rounds of each member, see `exploits`.
    """
    found = []
    for name, rounds in members.items():
        for event in rounds:
            if event["sources"]:
                whom = ", ".join(f"{kind} of {source}" for kind, source in event["sources"].items())
                values = (f"{key} {event['before'][key]:.3g} to {value:.3g}" for key, value in _values(event))
                said = f"round {event['round']}: {name} imitated {whom}, share {event['rate']:.3g}"
                found.append((event["round"], "; ".join((said, *values))))
    return [text for _, text in sorted(found)]


def _values(event: Mapping[str, Any]) -> list[tuple[str, float]]:
    return sorted(event["hyperparameters"].items())


def lineage(members: Mapping[str, Sequence[Mapping[str, Any]]], path: Path, title: str) -> None:
    """Draw the scores and hyperparameters of all members over the rounds, with an arrow for each imitation.

    Args:
        members: rounds of each member, see `exploits`; one or more in all.
        path: the PNG file.
        title: of the picture.
    """
    names = sorted({key for rounds in members.values() for event in rounds for key in event["hyperparameters"]})
    figure = Figure(figsize=(8.0, 3.2 + 2.0 * len(names)), dpi=DPI, layout="constrained")
    top, *others = figure.subplots(1 + len(names), 1, sharex=True, squeeze=False)[:, 0]
    for number, (name, rounds) in enumerate(members.items()):
        colour = OTHER_COLOURS[number % len(OTHER_COLOURS)]
        numbers = [event["round"] for event in rounds]
        top.plot(numbers, [event["scores"][name] for event in rounds], "o-", color=colour, label=name, markersize=4)
        for key, axes in zip(names, others, strict=True):
            values = [event["hyperparameters"][key] for event in rounds]
            axes.step(numbers, values, "o-", color=colour, where="post", markersize=4)
        for event in rounds:
            for source in sorted(set(event["sources"].values())):
                ends = (event["round"], event["scores"][name]), (event["round"], event["scores"][source])
                top.annotate("", *ends, arrowprops={"arrowstyle": "->", "color": colour, "shrinkB": 4.0})
    top.set_title(f"{title}; arrows lead to who imitates", fontsize=10)
    top.set_ylabel("score omega")
    top.xaxis.set_major_locator(MaxNLocator(integer=True))
    top.legend(fontsize=8)
    for key, axes in zip(names, others, strict=True):
        axes.set_ylabel(key)
        axes.set_yscale("log")
    (others or [top])[-1].set_xlabel("round")
    figure.savefig(path)
