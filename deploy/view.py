"""The live view of a run, the same for `eia-sec train` and `eia-sec monitor`: a pure function of a snapshot.

Whoever collects the metric messages assembles a `Snapshot`; `render` draws it at any width from 80 columns on, and
`summary` says the essence in one line where there is no terminal. What is not known yet is None and drawn as "-".
"""

from dataclasses import dataclass, field
from typing import Final

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from deploy.sparkline import Sparkline

SMOOTHING: Final = 20
"""Newest values whose mean counts as a series' latest."""
ROWS: Final = 8
"""Most processes that the table shows; with more of them, those in trouble come first."""
ALARMS: Final = 2
"""Newest alarms that are shown."""
QUIET_SECONDS: Final = 5.0
"""Age of a process's last message from which on it is marked, s."""
_STATE_STYLES: Final = {"training": "green", "draining": "yellow", "finished": "green"}
_ROLE_STYLES: Final = {"learner": "magenta", "elite": "yellow", "rollout": "cyan", "monitor": "dim"}


@dataclass(frozen=True)
class Series:
    """One figure over time.

    Attributes:
        name: what it is called in the view.
        values: oldest first, one for each episode or report.
        digits: decimals that are shown.
    """

    name: str
    values: tuple[float, ...] = ()
    digits: int = 1

    @property
    def latest(self) -> float | None:
        """Mean of the newest SMOOTHING values, or None when there is none."""
        newest = self.values[-SMOOTHING:]
        return sum(newest) / len(newest) if newest else None


@dataclass(frozen=True)
class Ledger:
    """Where the produced environment steps are: produced = accepted + rejected + lost + in flight + unexplained.

    Attributes:
        produced, accepted, rejected, lost, in_flight, unexplained: environment steps.
        duplicates: chunks that came again and were not taken in.
    """

    produced: int = 0
    accepted: int = 0
    duplicates: int = 0
    rejected: int = 0
    lost: int = 0
    in_flight: int = 0
    unexplained: int = 0


@dataclass(frozen=True)
class Imitation:
    """The elite imitation so far.

    Attributes:
        events: number of events applied.
        rate: vartheta of the newest event.
        next_episode: the episode at which the next event falls due.
        elites: for each type, its name and the newest elite's index inside it.
    """

    events: int = 0
    rate: float | None = None
    next_episode: int | None = None
    elites: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True)
class ProcessRow:
    """One process of the fleet.

    Attributes:
        role: learner, elite, rollout or monitor.
        name: its name inside the role.
        host: the machine's name.
        pid: its process number.
        uptime: seconds since its start.
        rate: environment steps or updates per second, whatever the role makes.
        version: parameter version that it holds.
        episodes: episodes that it finished.
        queue: chunks that wait in it.
        age: seconds since its last message.
        alive: whether its liveliness token stands.
    """

    role: str
    name: str
    host: str
    pid: int
    uptime: float
    rate: float | None = None
    version: int | None = None
    episodes: int | None = None
    queue: int | None = None
    age: float = 0.0
    alive: bool = True

    @property
    def quiet(self) -> bool:
        """Whether it is gone or has said nothing for QUIET_SECONDS."""
        return not self.alive or self.age >= QUIET_SECONDS


@dataclass(frozen=True)
class Snapshot:
    """Everything that the view shows, at one moment.

    Attributes:
        run: the run's name.
        state: starting, training, draining or finished.
        elapsed: seconds since the start.
        left: estimated seconds to the end.
        episodes, episodes_total: training episodes finished, and lambda_max.
        reward: mean reward per agent, first over all agents, then for each type.
        freshness: AoI and VDF, units, or the length of episodes where there are none.
        steps, steps_rate: environment steps accepted, and per second.
        updates, updates_rate: update rounds done, and per second.
        staleness: mean over workers of the parameter versions by which they lag behind the learner.
        learner_wait: share of time in which the learner waits for data, 0..1.
        worker_wait: mean share of time in which the workers wait for the learner, 0..1.
        ledger: where the produced steps are.
        imitation: the elite imitation so far.
        processes: one row for each process.
        alarms: sentences that somebody should read, newest last.
    """

    run: str
    state: str = "starting"
    elapsed: float = 0.0
    left: float | None = None
    episodes: int = 0
    episodes_total: int = 0
    reward: tuple[Series, ...] = ()
    freshness: tuple[Series, ...] = ()
    steps: int = 0
    steps_rate: float | None = None
    updates: int = 0
    updates_rate: float | None = None
    staleness: float | None = None
    learner_wait: float | None = None
    worker_wait: float | None = None
    ledger: Ledger = field(default_factory=Ledger)
    imitation: Imitation = field(default_factory=Imitation)
    processes: tuple[ProcessRow, ...] = ()
    alarms: tuple[str, ...] = ()


def render(snapshot: Snapshot) -> RenderableType:
    """Return the whole view as a rich renderable."""
    parts: list[RenderableType] = [
        _header(snapshot),
        _beside(_learning(snapshot), _flow(snapshot), (1, 1)),
        _beside(_ledger(snapshot.ledger), _imitation(snapshot.imitation), (3, 2)),
        _processes(snapshot.processes),
    ]
    if snapshot.alarms:
        parts.append(_alarms(snapshot.alarms))
    return Group(*parts)


def summary(snapshot: Snapshot) -> str:
    """Return the essence in one line of plain text."""
    rewards = ", ".join(f"{series.name} {_number(series.latest, series.digits)}" for series in snapshot.reward)
    parts = [
        f"{snapshot.state}: episode {snapshot.episodes:,} of {snapshot.episodes_total:,}",
        f"reward {rewards}" if rewards else "",
        f"{_number(snapshot.steps_rate)} steps/s",
        f"{_number(snapshot.updates_rate)} updates/s",
        f"{duration(snapshot.left)} left" if snapshot.left is not None else "",
        _alarm_count(len(snapshot.alarms)),
    ]
    return "; ".join(part for part in parts if part)


def duration(seconds: float | None) -> str:
    """Return a time span as m:ss or h:mm:ss, or "-" when it is not known."""
    if seconds is None:
        return "-"
    minutes, rest = divmod(max(0, round(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


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
    bar = ProgressBar(total=max(1, snapshot.episodes_total), completed=snapshot.episodes)
    count = Text.assemble((f"{snapshot.episodes:,}", "bold"), f" of {snapshot.episodes_total:,} episodes")
    grid = Table.grid(expand=True, padding=(0, 1))
    grid.add_column(ratio=1, no_wrap=True)
    grid.add_column(justify="right", no_wrap=True)
    grid.add_row(title, times)
    grid.add_row(bar, count)
    return grid


def _learning(snapshot: Snapshot) -> Panel:
    grid = Table.grid(expand=True, padding=(0, 1))
    grid.add_column(no_wrap=True)
    grid.add_column(justify="right", no_wrap=True, min_width=7)
    grid.add_column(ratio=1, no_wrap=True)
    for index, series in enumerate(snapshot.reward):
        value = Text(_number(series.latest, series.digits), style="bold" if index == 0 else "")
        grid.add_row(series.name, value, Sparkline(series.values, "green"))
    for series in snapshot.freshness:
        grid.add_row(series.name, _number(series.latest, series.digits), Sparkline(series.values, "blue"))
    waiting = Text("No episode has ended yet.", style="dim")
    title = " and ".join(["reward per agent", *(series.name for series in snapshot.freshness)])
    return _panel(title, grid if grid.row_count else waiting)


def _flow(snapshot: Snapshot) -> Panel:
    grid = Table.grid(expand=True, padding=(0, 1))
    grid.add_column(ratio=1, no_wrap=True)
    grid.add_column(justify="right", no_wrap=True)
    grid.add_column(justify="right", no_wrap=True)
    grid.add_row("steps", f"{snapshot.steps:,}", f"{_number(snapshot.steps_rate)}/s")
    grid.add_row("updates", f"{snapshot.updates:,}", f"{_number(snapshot.updates_rate)}/s")
    ratio = snapshot.updates / snapshot.steps if snapshot.steps else None
    grid.add_row("updates/step", _number(ratio, 2), "")
    grid.add_row("staleness", _number(snapshot.staleness, 1), "versions")
    grid.add_row("learner waits", _percent(snapshot.learner_wait), "for data")
    grid.add_row("workers wait", _percent(snapshot.worker_wait), "for learner")
    return _panel("flow", grid)


def _ledger(ledger: Ledger) -> Panel:
    rows = (
        (("produced", ledger.produced, ""), ("rejected", ledger.rejected, "yellow")),
        (("accepted", ledger.accepted, ""), ("lost", ledger.lost, "yellow")),
        (("in flight", ledger.in_flight, ""), ("unexplained", ledger.unexplained, "bold red")),
    )
    grid = Table.grid(expand=True, padding=(0, 1))
    for _ in range(2):
        grid.add_column(ratio=1, no_wrap=True)
        grid.add_column(justify="right", no_wrap=True)
    for pair in rows:
        # A style stands for trouble, so it shows only on a count that is not zero.
        grid.add_row(
            *(Text(text, style if count else "") for name, count, style in pair for text in (name, f"{count:,}"))
        )
    return _panel(f"ledger, steps ({ledger.duplicates:,} duplicate chunks)", grid)


def _imitation(imitation: Imitation) -> Panel:
    grid = Table.grid(expand=True, padding=(0, 1))
    grid.add_column(no_wrap=True)
    grid.add_column(justify="right", ratio=1, no_wrap=True)
    grid.add_row("events", f"{imitation.events}, rate {_rate(imitation.rate)}")
    due = "-" if imitation.next_episode is None else f"episode {imitation.next_episode:,}"
    grid.add_row("next at", due)
    grid.add_row("elites", " ".join(f"{name} {index}" for name, index in imitation.elites) or "-")
    return _panel("elite imitation", grid)


def _processes(rows: tuple[ProcessRow, ...]) -> Panel:
    table = Table(box=None, expand=True, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
    table.add_column("role", no_wrap=True)
    table.add_column("name", no_wrap=True, ratio=3, min_width=6)
    table.add_column("host", no_wrap=True, ratio=2, min_width=6)
    for name in ("pid", "up", "per s", "version", "episodes", "queue", "heard"):
        table.add_column(name, justify="right", no_wrap=True)
    hidden = len(rows) - ROWS
    for row in sorted(rows, key=lambda row: not row.quiet)[:ROWS] if hidden > 0 else rows:
        table.add_row(*_process_cells(row))
    title = f"processes ({len(rows)}, {hidden} not shown)" if hidden > 0 else f"processes ({len(rows)})"
    return _panel(title, table)


def _process_cells(row: ProcessRow) -> list[RenderableType]:
    return [
        Text(row.role, style=_ROLE_STYLES.get(row.role, "")),
        Text(row.name),
        Text(row.host),
        str(row.pid),
        duration(row.uptime),
        _number(row.rate),
        _count(row.version),
        _count(row.episodes),
        _count(row.queue),
        Text(f"{row.age:.0f} s" if row.alive else "gone", style="bold red" if row.quiet else ""),
    ]


def _alarms(alarms: tuple[str, ...]) -> Panel:
    older = len(alarms) - ALARMS
    title = f"alarms ({older} older)" if older > 0 else "alarms"
    lines = Text("\n".join(alarms[-ALARMS:]), overflow="ellipsis", no_wrap=True)
    return Panel(lines, title=title, title_align="left", border_style="red", padding=(0, 1))


def _panel(title: str, content: RenderableType) -> Panel:
    return Panel(content, title=title, title_align="left", border_style="dim", padding=(0, 1))


def _number(value: float | None, digits: int = 0) -> str:
    return "-" if value is None else f"{value:,.{digits}f}"


def _rate(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.0%}"


def _count(value: int | None) -> str:
    return "-" if value is None else f"{value:,}"


def _alarm_count(number: int) -> str:
    return {0: "", 1: "1 alarm"}.get(number, f"{number} alarms")
