"""The live view of a population: a line for each member, by its snapshot."""

from collections.abc import Mapping, Sequence

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from eia_sec.deploy.monitor.live_view import MOST_ALARMS, membership, summary
from eia_sec.deploy.monitor.snapshot import Snapshot
from eia_sec.deploy.monitor.tables import duration, number


def render_population(members: Mapping[str, Snapshot | None], alarms: Sequence[str] = ()) -> RenderableType:
    """Return the view of all members; one whose learner was not reached yet has no snapshot.

    Args:
        members: snapshots by name.
        alarms: sentences of the population itself; those of members follow.
    """
    table = Table(box=None, expand=True, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
    for name in ("member", "state"):
        table.add_column(name, no_wrap=True)
    for name in ("done", "left", "reward", "steps/s", "unexplained"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("population", ratio=1)
    found = list(alarms)
    for name, snapshot in members.items():
        if snapshot is None:
            table.add_row(name, "starting", *["-"] * 5, "")
            continue
        reward = snapshot.reward[0] if snapshot.reward else None
        table.add_row(
            name,
            snapshot.state,
            f"{snapshot.progress:.0%}",
            duration(snapshot.left),
            "-" if reward is None else number(reward.latest, reward.digits),
            number(snapshot.steps_rate),
            Text(str(snapshot.ledger.unexplained), style="bold red" if snapshot.ledger.unexplained else ""),
            "" if snapshot.population is None else membership(snapshot.population),
        )
        found += [f"{name}: {text}" for text in snapshot.alarms]
    parts: list[RenderableType] = [Panel(table, title="population", title_align="left", border_style="dim")]
    if found:
        lines = Text("\n".join(found[-MOST_ALARMS:]), overflow="ellipsis", no_wrap=True)
        parts.append(Panel(lines, title=f"alarms ({len(found)})", title_align="left", border_style="red"))
    return Group(*parts)


def summaries(members: Mapping[str, Snapshot | None]) -> list[str]:
    """Return a line of plain text for each member."""
    return [f"{name}: {'starting' if one is None else summary(one)}" for name, one in members.items()]
