"""Tables of the live view whose columns depend on the width: the processes with their ledgers, and imitation events."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from eia_sec.deploy.monitor.snapshot import ImitationRow, LedgerCounts, ProcessRow, Snapshot

NARROW: Final = 0
MIDDLE: Final = 96
WIDE: Final = 130
"""Widths in cells from which a column is shown."""
_ROLE_STYLES: Final = {"learner": "magenta", "elite": "yellow", "rollout": "cyan", "flight": "green"}
_LOSS: Final = "yellow"
_TROUBLE: Final = "bold red"


@dataclass(frozen=True)
class _Column:
    name: str
    least: int
    cell: Callable[[ProcessRow], RenderableType]
    right: bool = True


def duration(seconds: float | None) -> str:
    """Return a time span as m:ss or h:mm:ss, or "-" if it is unknown."""
    if seconds is None:
        return "-"
    minutes, rest = divmod(max(0, round(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def number(value: float | None, digits: int = 0) -> str:
    """Return a number with thousands' commas, or "-" if it is unknown."""
    return "-" if value is None else f"{value:,.{digits}f}"


def short(value: int | None) -> str:
    """Return a count in at most six cells: exact below 100,000, else in thousands, millions or billions."""
    if value is None or abs(value) < 100_000:
        return number(value)
    for letter, size in (("k", 1e3), ("M", 1e6), ("G", 1e9)):
        if value < 999.5 * size or letter == "G":
            break
    return f"{value / size:,.{0 if value >= 99.95 * size else 1}f}{letter}"


def _count(value: int | None, style: str = "") -> Text:
    # The style marks trouble, so it is used only for counts above zero.
    return Text(short(value), style if value else "")


def _of(field: Callable[[LedgerCounts], int | None], style: str = "") -> Callable[[ProcessRow], Text]:
    return lambda row: Text("") if row.ledger is None else _count(field(row.ledger), style)


def _seen(row: ProcessRow) -> Text:
    if row.left:
        return Text("left")
    return Text(f"{row.age:.0f} s" if row.alive else "gone", style=_TROUBLE if row.quiet else "")


_COLUMNS: Final = (
    _Column("role", NARROW, lambda row: Text(row.role, style=_ROLE_STYLES.get(row.role, "")), right=False),
    _Column("name", NARROW, lambda row: Text(row.name, style=_TROUBLE if row.trouble else ""), right=False),
    _Column("host", NARROW, lambda row: Text(row.host), right=False),
    _Column("pid", WIDE, lambda row: str(row.pid or "-")),
    _Column("up", NARROW, lambda row: "-" if row.left else duration(row.uptime)),
    _Column("seen", NARROW, _seen),
    _Column("per s", NARROW, lambda row: number(row.rate)),
    _Column("version", WIDE, lambda row: short(row.version)),
    _Column("behind", NARROW, lambda row: short(row.behind)),
    _Column("episodes", WIDE, lambda row: short(row.episodes)),
    _Column("queue", MIDDLE, lambda row: short(row.queue)),
    _Column("produced", WIDE, _of(lambda ledger: ledger.produced)),
    _Column("accepted", MIDDLE, _of(lambda ledger: ledger.accepted)),
    _Column("in flight", MIDDLE, _of(lambda ledger: ledger.in_flight)),
    _Column("flight", NARROW, _of(lambda ledger: ledger.in_flight)),
    _Column("lost", NARROW, _of(lambda ledger: ledger.lost, _LOSS)),
    _Column("rejected", MIDDLE, _of(lambda ledger: ledger.rejected, _LOSS)),
    _Column("reject", NARROW, _of(lambda ledger: ledger.rejected, _LOSS)),
)
_ABBREVIATED: Final = {"flight": "in flight", "reject": "rejected"}
"""Abbreviated columns of a narrow table, and the columns that replace them in a wide one."""


@dataclass(frozen=True)
class ProcessTable:
    """The processes, with as many columns as fit.

    Attributes:
        snapshot: what to show.
        rows: most rows; of more processes those in trouble come first, then those that are not workers, and the last
            row sums what is not shown.
    """

    snapshot: Snapshot
    rows: int

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width
        chosen = [column for column in _COLUMNS if column.least <= width]
        names = {column.name for column in chosen}
        chosen = [column for column in chosen if _ABBREVIATED.get(column.name) not in names]
        table = Table(box=None, expand=True, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
        for column in chosen:
            share = {"name": 3, "host": 2}.get(column.name)
            table.add_column(
                column.name,
                justify="right" if column.right else "left",
                no_wrap=True,
                ratio=share,
                min_width=6 if share else None,
            )
        shown, hidden = self.parts()
        for row in shown:
            table.add_row(*(column.cell(row) for column in chosen))
        if hidden:
            rest = _summed(hidden)
            table.add_row(*(column.cell(rest) for column in chosen), style="dim")
        yield table

    def parts(self) -> tuple[list[ProcessRow], list[ProcessRow]]:
        """Return the rows that are shown and those that are summed."""
        rows = list(self.snapshot.processes)
        if len(rows) <= self.rows:
            return rows, []
        ordered = sorted(rows, key=lambda row: (not (row.quiet or row.trouble), row.left, row.role == "rollout"))
        return ordered[: self.rows - 1], ordered[self.rows - 1 :]


def _summed(rows: Sequence[ProcessRow]) -> ProcessRow:
    """Return one row for many: sums of rates and steps, the worst of ages and versions."""
    ledgers = [row.ledger for row in rows if row.ledger is not None]
    known = [ledger.lost for ledger in ledgers if ledger.lost is not None]
    behind = [row.behind for row in rows if row.behind is not None]
    hosts = len({row.host for row in rows if not row.left})
    return ProcessRow(
        role=f"{len(rows)} others",
        name="",
        host=f"{hosts} host{'s' if hosts != 1 else ''}",
        pid=0,
        uptime=max(row.uptime for row in rows),
        rate=sum(row.rate or 0.0 for row in rows),
        behind=max(behind, default=None),
        queue=sum(row.queue or 0 for row in rows),
        age=max(row.age for row in rows),
        alive=all(row.alive or row.left for row in rows),
        ledger=LedgerCounts(
            produced=sum(ledger.produced for ledger in ledgers),
            accepted=sum(ledger.accepted for ledger in ledgers),
            rejected=sum(ledger.rejected for ledger in ledgers),
            lost=sum(known) if len(known) == len(ledgers) else None,
            in_flight=sum(ledger.in_flight for ledger in ledgers),
        ),
    )


@dataclass(frozen=True)
class EventTable:
    """Imitation events: which agent of each type scored best (its score is omega), and the share copied, vartheta.

    Attributes:
        events: oldest first.
    """

    events: tuple[ImitationRow, ...]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        table = Table(box=None, expand=True, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
        types = [name for name, _, _ in self.events[-1].elites]
        for name in ("event", "episode", "share", *(f"best {name} (score)" for name in types)):
            table.add_column(Text(name), justify="right", no_wrap=True)
        for event in self.events:
            elites = [f"{index} ({'-' if score is None else f'{score:.2f}'})" for _, index, score in event.elites]
            table.add_row(str(event.event), number(event.episode), f"{event.rate:.3g}", *elites)
        yield table
