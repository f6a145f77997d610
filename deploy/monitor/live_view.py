"""The live view of a run, the same for `eia-sec train` and `eia-sec monitor`: a pure function of a snapshot.

`eia_sec.deploy.monitor.run_monitor` assembles a `Snapshot` from metric messages; `render` draws it at any width from 80
columns and any height from 24 lines on, and `summary` condenses it to one line where there is no terminal. Unknown
values are drawn as "-".
"""

from typing import Final

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from eia_sec.deploy.monitor.snapshot import Imitation, LedgerCounts, Membership, Series, Snapshot
from eia_sec.deploy.monitor.sparkline import Sparkline
from eia_sec.deploy.monitor.tables import EventTable, ProcessTable, duration, number

HEIGHT: Final = 30
"""Height of the view if the terminal's is unknown, lines."""
MOST_ALARMS: Final = 8
"""Most alarms that are shown, whatever the terminal's height."""
EVENTS_FROM: Final = 18
"""Lines that must remain before imitation events are listed; processes take precedence."""
_STATE_STYLES: Final = {"training": "green", "draining": "yellow", "finished": "green"}


def render(snapshot: Snapshot, height: int = HEIGHT) -> RenderableType:
    """Return the whole view as a rich renderable.

    Args:
        snapshot: what to show.
        height: lines that it may take. More lines show more processes, imitation events and alarms. The view respects
            heights of 24 lines and above.
    """
    learning, ledger = _learning(snapshot), _ledger(snapshot.ledger)
    used = 2 + max(8, 2 + len(_curves(snapshot))) + 5
    alarms = min(len(snapshot.alarms), max(1, min(MOST_ALARMS, (height - used - 7) // 4)))
    used += alarms + 2 if alarms else 0
    used += 1 if snapshot.population else 0
    events = snapshot.imitation.newest if height - used >= EVENTS_FROM else ()
    used += len(events) + 3 if events else 0
    parts: list[RenderableType] = [
        _header(snapshot),
        *([Text(membership(snapshot.population), no_wrap=True, overflow="ellipsis")] if snapshot.population else []),
        _beside(learning, _flow(snapshot), (5, 4)),
        _beside(ledger, _imitation(snapshot.imitation), (3, 2)) if snapshot.imitation.happens else ledger,
        *([_panel("imitation events", EventTable(events))] if events else []),
        _panel(", ".join(_processes(snapshot)), ProcessTable(snapshot, max(2, height - used - 3))),
    ]
    if alarms:
        parts.append(_alarms(snapshot.alarms, alarms))
    return Group(*parts)


def summary(snapshot: Snapshot) -> str:
    """Return a summary in one line of plain text."""
    if not (snapshot.episodes_total or snapshot.steps_total):
        waiting = f"{snapshot.state}: no report from the learner yet"
        return "; ".join(filter(None, (waiting, _count(len(snapshot.alarms), "alarm"))))
    rewards = ", ".join(f"{series.name} {number(series.latest, series.digits)}" for series in _rewards(snapshot))
    parts = [
        f"{snapshot.state}: {_budget(snapshot)}",
        f"reward {rewards}" if rewards else "",
        f"{number(snapshot.steps_rate)} steps/s",
        f"{number(snapshot.updates_rate)} updates/s",
        f"{duration(snapshot.left)} left" if snapshot.left is not None else "",
        membership(snapshot.population) if snapshot.population else "",
        *_troubles(snapshot),
        _count(len(snapshot.alarms), "alarm"),
    ]
    return "; ".join(part for part in parts if part)


def membership(member: Membership) -> str:
    """Return what a learner is inside its population, in one line."""
    parts = [f"round {member.round} of its population"]
    if member.newest:
        newest = member.newest[-1]
        parts.append(f"rank {newest.rank or '-'} of {newest.members}")
    if imitated := [row for row in member.newest if row.sources]:
        whom = " ".join(f"{kind} {source}" for kind, source in imitated[-1].sources)
        parts.append(f"imitated in round {imitated[-1].round}: {whom}, share {imitated[-1].rate:.3g}")
    parts += [f"{name} {value:.3g}" for name, value in member.hyperparameters]
    return ", ".join(parts)


def _budget(snapshot: Snapshot) -> str:
    """Return how much of the run is done, in what ends it; what was under way at its end counts beyond the total."""
    if snapshot.steps_total and not snapshot.episodes_total:
        return f"{min(snapshot.steps, snapshot.steps_total):,} of {snapshot.steps_total:,} steps"
    return f"{min(snapshot.episodes, snapshot.episodes_total):,} of {snapshot.episodes_total:,} episodes"


def _beside(left: RenderableType, right: RenderableType, shares: tuple[int, int]) -> Table:
    grid = Table.grid(expand=True)
    for share in shares:
        grid.add_column(ratio=share)
    grid.add_row(left, right)
    return grid


def _header(snapshot: Snapshot) -> RenderableType:
    title = Text.assemble(
        ("EIA-SEC ", "bold"),
        f"{snapshot.run}  ",
        (snapshot.state, _STATE_STYLES.get(snapshot.state, "yellow")),
    )
    times = f"{duration(snapshot.elapsed)} elapsed, {duration(snapshot.left)} left"
    bar = ProgressBar(total=1.0, completed=min(1.0, snapshot.progress))
    grid = Table.grid(expand=True, padding=(0, 1))
    grid.add_column(ratio=1, no_wrap=True)
    grid.add_column(justify="right", no_wrap=True)
    grid.add_row(title, times)
    grid.add_row(bar, _budget(snapshot))
    return grid


def _learning(snapshot: Snapshot) -> Panel:
    grid = Table.grid(expand=True, padding=(0, 1))
    grid.add_column(no_wrap=True)
    grid.add_column(justify="right", no_wrap=True, min_width=7)
    grid.add_column(ratio=1, no_wrap=True)
    for index, (series, colour) in enumerate(_curves(snapshot)):
        value = Text(number(series.latest, series.digits), style="bold" if index == 0 else "")
        grid.add_row(Text(series.name), value, Sparkline(series.values, colour, 120, series.digits))
    waiting = Text("No episode has ended yet.", style="dim")
    rewards = "reward per agent" if snapshot.noise_free.values else "reward per agent with noise"
    title = ", ".join([rewards, *(series.name for series in snapshot.freshness)])
    return _panel(title, grid if grid.row_count else waiting)


def _curves(snapshot: Snapshot) -> list[tuple[Series, str]]:
    """Return the curves and their colours: the rewards, then the other metrics."""
    found = [(series, "yellow" if series is snapshot.noise_free else "green") for series in _rewards(snapshot)]
    return [*found, *((series, "blue") for series in snapshot.freshness)]


def _rewards(snapshot: Snapshot) -> list[Series]:
    """Return the rewards: the mean, that without noise if it is known, and each type's."""
    known = [snapshot.noise_free] if snapshot.noise_free.values else []
    return [*snapshot.reward[:1], *known, *snapshot.reward[1:]]


def _flow(snapshot: Snapshot) -> Panel:
    grid = Table.grid(expand=True, padding=(0, 1))
    grid.add_column(ratio=1, no_wrap=True)
    grid.add_column(justify="right", no_wrap=True)
    grid.add_column(justify="right", no_wrap=True)
    grid.add_row("steps", f"{snapshot.steps:,}", f"{number(snapshot.steps_rate)}/s")
    grid.add_row("updates", f"{snapshot.updates:,}", f"{number(snapshot.updates_rate)}/s")
    grid.add_row("staleness", number(snapshot.staleness, 1), "versions")
    grid.add_row("learner idle", _percent(snapshot.learner_wait), "")
    grid.add_row("workers idle", _percent(snapshot.worker_wait), "")
    return _panel("flow", grid)


def _ledger(ledger: LedgerCounts) -> Panel:
    rows = (
        (("produced", ledger.produced, ""), ("rejected", ledger.rejected, "yellow")),
        (("accepted", ledger.accepted, ""), ("lost", ledger.lost or 0, "yellow")),
        (("in flight", ledger.in_flight, ""), ("unexplained", ledger.unexplained, "bold red")),
    )
    grid = Table.grid(expand=True, padding=(0, 1))
    for _ in range(2):
        grid.add_column(ratio=1, no_wrap=True)
        grid.add_column(justify="right", no_wrap=True)
    for pair in rows:
        # The style marks trouble, so it is used only for counts above zero.
        grid.add_row(
            *(Text(text, style if count else "") for name, count, style in pair for text in (name, f"{count:,}"))
        )
    return _panel(f"ledger, steps ({ledger.duplicates:,} duplicate chunks)", grid)


def _imitation(imitation: Imitation) -> Panel:
    grid = Table.grid(expand=True, padding=(0, 1))
    grid.add_column(no_wrap=True)
    grid.add_column(justify="right", ratio=1, no_wrap=True)
    grid.add_row("events", f"{imitation.events}, share {_rate(imitation.rate)}")
    due = "-" if imitation.next_episode is None else f"episode {imitation.next_episode:,}"
    grid.add_row("next at", due)
    grid.add_row("best", Text(" ".join(f"{name} {index}" for name, index, _ in imitation.elites) or "-"))
    return _panel("elite imitation", grid)


def _alarms(alarms: tuple[str, ...], shown: int) -> Panel:
    hidden = len(alarms) - shown
    title = f"alarms ({hidden} more)" if hidden > 0 else "alarms"
    lines = Text("\n".join(alarms[-shown:]), overflow="ellipsis", no_wrap=True)
    return Panel(lines, title=title, title_align="left", border_style="red", padding=(0, 1))


def _panel(title: str, content: RenderableType) -> Panel:
    return Panel(content, title=Text(title), title_align="left", border_style="dim", padding=(0, 1))


def _rate(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.0%}"


def _processes(snapshot: Snapshot) -> list[str]:
    """Return how many processes there are, and what their environments did."""
    return [f"processes ({len(snapshot.processes)})", *filter(None, _troubles(snapshot))]


def _troubles(snapshot: Snapshot) -> tuple[str, str]:
    """Return how often environments were away, and were ended because a call took too long; empty for never."""
    return _count(snapshot.outages, "outage"), _count(snapshot.step_timeouts, "step timeout")


def _count(number: int, what: str) -> str:
    """Return how many there are, or an empty text for none."""
    return f"{number} {what}{'s' if number > 1 else ''}" if number else ""
