"""A process's history: what it did with each chunk, line by line, so that an audit can compare processes.

One JSON array per line, the first of which is ["history", FORMAT]; then

    ["start", role, name, incarnation]                   a process began; the learner's incarnation is its epoch
    ["resume", {worker: [incarnation, expected], ...}]   the learner resumed from a checkpoint; each worker in it
    ["end"]                                              the process ended normally
    ["timeout"]                                          a call of its environment took too long, and it was ended
    ["drawing", true]                                    its environment draws from now on; false: no more
    [verdict, worker, incarnation, first, last, steps, produced, flown]
    ["sum", worker, incarnation, last, ...]              totals of a start's chunks up to `last`, see `Summary`

The sixth form is a verdict on chunks `first` to `last` of one start of a worker, each of `steps` environment steps.
`produced` and `flown` are the worker's counts including the last of them (see
`eia_sec.common.protocol.messages.ChunkMessage`).

A worker writes *produced* for each chunk, and then the learner's answer: *acknowledged*, *repeated* (the learner had it
already) or *refused*. The learner writes *accepted*, *refused*, *duplicate*, *missing* (chunks before `first` can no
longer arrive) and *undelivered* (a newer start of the worker delivers, and this one had flown further than its last
chunk). In lines with one of the last three, `steps` is the total of the line.

A line reaches the operating system before the process acts on it: it survives a killed process, but not a power cut.
The file stays small because consecutive chunks are merged into one line every REWRITE_LINES lines, and because a
learner keeps only totals of chunks that are in every checkpoint (`eia_sec.common.history.summary`).
"""

import json
import os
import re
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final, TextIO

from eia_sec.common.names import is_name

FORMAT: Final = 1
"""Number of the form of a history. It rises when a line is removed or means something else."""
REWRITE_LINES: Final = 20_000
"""Number of lines after which the file is rewritten, with consecutive chunks joined."""
MAX_BYTES: Final = 256 * 2**20
"""Largest history that is read, bytes."""
MOST_JOINED: Final = 2**24
"""Most chunks in one line; longer ranges are split."""
_FIRST: Final = re.compile(r'\["history",(\d{1,9})\]')
VERDICTS: Final = ("produced", "acknowledged", "repeated", "refused", "accepted", "duplicate", "missing", "undelivered")
SUMMED: Final = ("duplicate", "missing", "undelivered")
"""Verdicts whose lines hold a total, not one chunk after another."""


@dataclass(frozen=True)
class Start:
    """A process started."""

    role: str
    name: str
    incarnation: int


@dataclass(frozen=True)
class Resume:
    """The learner resumed from a checkpoint, which holds each worker's incarnation and next sequence number."""

    workers: dict[str, tuple[int, int]]


@dataclass(frozen=True)
class End:
    """The process ended normally."""


@dataclass(frozen=True)
class Timeout:
    """The process was ended because a call of its environment took longer than `env.step_timeout`."""


@dataclass(frozen=True)
class Drawing:
    """Code of the process's environment draws pictures from now on, or does no more."""

    begins: bool


@dataclass(frozen=True)
class Entry:
    """A verdict on one or more consecutive chunks; see the module's docstring."""

    verdict: str
    worker: str
    incarnation: int
    first: int
    last: int
    steps: int
    produced: int = 0
    flown: int = 0

    @property
    def numbers(self) -> range:
        """Return the sequence numbers of its chunks; empty if the line holds a total."""
        return range(0) if self.verdict in SUMMED else range(self.first, self.last + 1)


@dataclass(frozen=True)
class Unreadable:
    """A line that is not a record; it stays in the file, so that every audit finds it.

    Attributes:
        line: the line.
        number: its number in the file that was read.
    """

    line: str
    number: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Summary:
    """Totals of a start's chunks up to a sequence number; they replace the single lines.

    Attributes:
        worker: the worker's name.
        incarnation: number of its start.
        last: sequence number of the newest chunk in the totals.
        accepted, refused, lost: chunks with each outcome; lost ones were accepted after the checkpoint of a resume.
        accepted_steps, refused_steps, lost_steps: environment steps in them, as far as known.
        missing_steps: steps of chunks that never arrived.
        undelivered_steps: steps that the start had flown beyond its last chunk when a newer one replaced it.
        duplicates: chunks that arrived again.
    """

    worker: str
    incarnation: int
    last: int
    accepted: int = 0
    accepted_steps: int = 0
    refused: int = 0
    refused_steps: int = 0
    lost: int = 0
    lost_steps: int = 0
    missing_steps: int = 0
    undelivered_steps: int = 0
    duplicates: int = 0

    def plus(self, other: "Summary") -> "Summary":
        """Return the sum with another part of the same start."""
        names = [item.name for item in fields(self)][3:]
        added = {name: getattr(self, name) + getattr(other, name) for name in names}
        return replace(self, last=max(self.last, other.last), **added)


Record = Start | Resume | End | Timeout | Drawing | Entry | Summary | Unreadable


def parse(line: str) -> Record:
    """Return the record in a line; raise ValueError when the line is not a record."""
    try:
        match json.loads(line):
            case ["start", str(role), str(name), int(incarnation)]:
                return Start(_name(role), _name(name), _whole(incarnation)[0])
            case ["resume", dict(workers)]:
                return Resume({_name(name): _whole(inc, expected) for name, (inc, expected) in workers.items()})
            case ["end" | "timeout" as word]:
                return End() if word == "end" else Timeout()
            case ["drawing", bool(begins)]:
                return Drawing(begins)
            case ["sum", str(worker), *numbers] if len(numbers) == len(fields(Summary)) - 1:
                return Summary(_name(worker), *_whole(*numbers))
            case [str(verdict), str(worker), *numbers] if len(numbers) == 6:
                entry = Entry(verdict, _name(worker), *_whole(*numbers))
                if verdict not in VERDICTS:
                    raise ValueError("the line has an unknown verdict")
                if verdict in SUMMED or 0 <= entry.last - entry.first < MOST_JOINED:
                    return entry
    except (TypeError, RecursionError) as error:
        raise ValueError(str(error)) from error
    raise ValueError("the line is not a record of a history")


def _name(value: str) -> str:
    """Return a process's name; raise ValueError when it is not a valid name, because an audit prints it."""
    if not is_name(value):
        raise ValueError("a name in the line is not valid")
    return value


def _whole(*numbers: Any) -> Any:
    """Return the numbers; raise ValueError unless all are whole, at least 0 and below 2**63."""
    if not all(type(number) is int and 0 <= number < 2**63 for number in numbers):
        raise ValueError("a number in the line is out of range")
    return numbers


def text(record: Record) -> str:
    """Return the line of a record."""
    match record:
        case Start():
            parts: list[Any] = ["start", record.role, record.name, record.incarnation]
        case Resume():
            parts = ["resume", record.workers]
        case End():
            parts = ["end"]
        case Timeout():
            parts = ["timeout"]
        case Drawing():
            parts = ["drawing", record.begins]
        case Entry():
            parts = list(vars(record).values())
        case Summary():
            parts = ["sum", *vars(record).values()]
        case Unreadable():
            return record.line
    return json.dumps(parts, separators=(",", ":"))


def read(path: Path) -> tuple[list[Record], int]:
    """Return a history's records, one for each line, and the number of truncated lines: 1 or 0.

    A killed process or a full disk may truncate the last line, which is then not a record and has no line break. Any
    other line that is not a record was damaged later.

    Raises:
        OSError: when the file cannot be read.
        ValueError: when it is larger than MAX_BYTES, or has another format.
    """
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"{path.name} is larger than {MAX_BYTES} bytes")
    records: list[Record] = []
    whole = path.read_text(encoding="utf-8", errors="replace")
    lines = whole.splitlines()
    first = _check_format(path.name, lines)
    for number, line in enumerate(lines[first:], start=first + 1):
        try:
            records.append(parse(line))
        except ValueError:
            records.append(Unreadable(line, number))
    torn = bool(records) and isinstance(records[-1], Unreadable) and not whole.endswith("\n")
    return records[:-1] if torn else records, int(torn)


def _check_format(name: str, lines: list[str]) -> int:
    """Return how many lines say the format: 1, or 0 if that line is damaged; raise ValueError for another format."""
    found = _FIRST.fullmatch(lines[0]) if lines else None
    if found is not None and int(found[1]) != FORMAT:
        raise ValueError(f"{name} has format {found[1]}, and this version reads {FORMAT}")
    return int(found is not None)


class _Joined:
    """Records with consecutive chunks joined, but never across the start of a process."""

    def __init__(self) -> None:
        self._records: list[Record] = []
        self._open: dict[tuple[str, str, int], int] = {}

    def __iter__(self) -> Iterator[Record]:
        return iter(self._records)

    def __len__(self) -> int:
        return len(self._records)

    def add(self, record: Record) -> None:
        """Append a record, or join it with an earlier one that it continues."""
        if not isinstance(record, Entry):
            self._open.clear()
            self._records.append(record)
            return
        key = record.verdict, record.worker, record.incarnation
        place = self._open.get(key)
        before = None if place is None else self._records[place]
        if place is not None and isinstance(before, Entry):
            if record.verdict == "duplicate":
                first, last = min(before.first, record.first), max(before.last, record.last)
                self._records[place] = replace(before, first=first, last=last, steps=before.steps + record.steps)
                return
            follows = record.first == before.last + 1 and record.last - before.first < MOST_JOINED
            if record.verdict not in SUMMED and follows and record.steps == before.steps:
                self._records[place] = replace(before, last=record.last, produced=record.produced, flown=record.flown)
                return
        self._open[key] = len(self._records)
        self._records.append(record)


class History:
    """Writes a process's history; without a path it writes nothing.

    An existing file is continued; an unreadable one is kept under another name. If the disk is full or the file was
    removed while in use, `failure` says so, and the next record rewrites the whole file from memory. Once another
    process has replaced the file with its own, this one stops writing (`taken_over`).

    Args:
        path: the file; its folder is created.

    Attributes:
        failure: why the file is incomplete, or empty.
        before: the records of earlier starts.
    """

    def __init__(self, path: Path | None) -> None:
        self.failure = self._standing = ""
        self.before: list[Record] = []
        self._path = path
        self._joined = _Joined()
        self._file: TextIO | None = None
        self._lines = 0
        self._identity: tuple[int, int] | None = None
        self._taken_over = False
        self._lock = threading.Lock()
        if path is not None:
            self._take_up(path)

    @property
    def taken_over(self) -> bool:
        """Whether another process has taken over this history."""
        with self._lock:
            if self._path is not None:
                self._look_for_another_writer(self._path)
            return self._taken_over

    def add(self, record: Record) -> None:
        """Append one record, unless another process has taken over the file."""
        if self._path is None:
            return
        with self._lock:
            removed = self._look_for_another_writer(self._path)
            if self._taken_over:
                return
            self._joined.add(record)
            self._lines += 1
            if removed and self._file is not None:
                self._standing = f"{self._path.name} was removed while in use and has been written anew."
            if self._file is None or removed or self._lines >= REWRITE_LINES:
                self._rewrite(self._path)
                return
            try:
                self._file.write(text(record) + "\n")
                self._file.flush()
            except (OSError, ValueError) as error:
                self._fail(error)

    @property
    def records(self) -> int:
        """Return the number of records once consecutive chunks are joined."""
        return len(self._joined)

    def rewrite(self, change: Callable[[Iterable[Record]], Iterable[Record]]) -> None:
        """Replace all records by what `change` returns for them."""
        with self._lock:
            if self._path is None or self._look_for_another_writer(self._path) or self._taken_over:
                return
            joined = _Joined()
            for record in change(self._joined):
                joined.add(record)
            self._joined = joined
            self._rewrite(self._path)

    def close(self) -> None:
        """Record a normal end and close the file."""
        self.add(End())
        with self._lock:
            self._shut()
            self._path = None

    def _look_for_another_writer(self, path: Path) -> bool:
        """Check that the file at the path is still this process's own; return whether it was removed."""
        try:
            found = path.stat()
        except OSError:
            return True
        if self._identity is not None and (found.st_dev, found.st_ino) != self._identity:
            self._taken_over = True
            self.failure = self._standing = "another process writes this history; this process has stopped writing it."
            self._shut()
        return False

    def _take_up(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.exists():
                self.before = read(path)[0]
        except (OSError, ValueError) as error:
            self._keep_aside(path, error)
        for record in self.before:
            self._joined.add(record)
        self._rewrite(path)

    def _keep_aside(self, path: Path, error: Exception) -> None:
        """Rename an unreadable history and report it from now on, because its records are missing here."""
        if path.is_dir():  # somebody's folder, which stays where it is
            self._standing = f"no history can be written: {path} is a folder."
            return
        aside = path.with_name(path.name + ".unreadable")
        with suppress(OSError):
            os.replace(path, aside)
            why = getattr(error, "strerror", None) or error
            self._standing = f"the history of earlier starts could not be read ({why}); it is now {aside.name}."

    def _rewrite(self, path: Path) -> None:
        """Write the whole file under another name, then replace the old one, which stays if that fails."""
        self._shut()
        beside = path.with_name(path.name + ".new")
        try:
            path.parent.mkdir(exist_ok=True)
            with beside.open("w", encoding="utf-8") as file:
                file.write(f'["history",{FORMAT}]\n')
                file.writelines(text(record) + "\n" for record in self._joined)
                held = os.fstat(file.fileno())
            os.replace(beside, path)
            self._identity = held.st_dev, held.st_ino  # also where it cannot be opened again
            self._file = path.open("a", encoding="utf-8")
            self._lines = 0
            self.failure = self._standing
        except OSError as error:
            with suppress(OSError):
                beside.unlink(missing_ok=True)
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self.failure = f"the history could not be written: {getattr(error, 'strerror', None) or error}."
        self._shut()

    def _shut(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError as error:
                self.failure = f"the history could not be written: {error.strerror}."
