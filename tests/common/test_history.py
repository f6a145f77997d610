"""Histories say what happened, stay small, and survive torn lines and full disks."""

from pathlib import Path
from typing import Any

import pytest

from eia_sec.common.history import history
from eia_sec.common.history.history import (
    Drawing,
    End,
    Entry,
    History,
    Resume,
    Start,
    Timeout,
    Unreadable,
    parse,
    read,
    text,
)


def chunk(number: int, verdict: str = "accepted", steps: int = 10) -> Entry:
    return Entry(verdict, "w", 1, number, number, steps, number * steps, number * steps + 5)


def test_every_record_comes_back():
    """A record and the record of its line are equal."""
    for record in (
        Start("rollout", "w", 3),
        Resume({"w": (3, 7)}),
        End(),
        Timeout(),
        Drawing(True),
        Drawing(False),
        chunk(4),
    ):
        assert parse(text(record)) == record


@pytest.mark.parametrize(
    "line",
    [
        '["heard","w",1,1,1,1,1,1]',
        '["produced","w",1,1,9000000000000000000,1,1,1]',
        '["produced","w",1,5,4,1,1,1]',
        '["produced","w",1,1,1,1,1,1e3]',
        '["produced","w",1,1,1,1,1,18446744073709551616]',
        '["resume",{"w":[1e999,1]}]',
        '["resume",{"w":[1,1,1]}]',
        '["resume",{"w":["1",1]}]',
        '["resume",["w"]]',
        '["resume",{"../w":[1,1]}]',
        '["start","rollout","a\\u001b[2J",1]',
        '["made","a b",1,1,1,1,1,1]',
        '["drawing",1]',
        '["ended"]',
    ],
)
def test_what_no_process_writes_is_no_record(line):
    """Ranges without end, numbers that are none of ours, and other shapes are refused before anything is counted."""
    with pytest.raises(ValueError, match=r"."):
        parse(line)


def test_a_history_of_another_format_is_kept_aside(tmp_path):
    """The first line holds the format; one sentence refuses another, and the process writes a history of its own."""
    path = tmp_path / "h.jsonl"
    History(path).add(chunk(1))
    first, *rest = path.read_text().splitlines()
    assert (first, len(rest)) == ('["history",1]', 1)
    path.write_text("\n".join(['["history",2]', *rest, ""]))
    with pytest.raises(ValueError, match=r"^h\.jsonl has format 2, and this version reads 1$"):
        read(path)
    again = History(path)
    assert again.before == []
    assert "could not be read (h.jsonl has format 2, and this version reads 1); it is now" in again.failure
    assert '["history",2]' in (tmp_path / "h.jsonl.unreadable").read_text()


def test_a_range_that_grows_too_long_is_two_lines(tmp_path, monkeypatch):
    """No line is about more chunks than one that is read may."""
    monkeypatch.setattr(history, "MOST_JOINED", 100)
    path = tmp_path / "h.jsonl"
    one = History(path)
    for number in range(1, 251):
        one.add(chunk(number))
    one.close()
    assert [(r.first, r.last) for r in History(path).before if isinstance(r, Entry)] == [(n, n) for n in range(1, 251)]
    assert [(r.first, r.last) for r in read(path)[0] if isinstance(r, Entry)] == [(1, 100), (101, 200), (201, 250)]


def test_consecutive_chunks_are_joined_when_the_file_is_written_anew(tmp_path, monkeypatch):
    """However many chunks, the file keeps to a few lines, and nothing that it says is lost."""
    monkeypatch.setattr(history, "REWRITE_LINES", 100)
    path = tmp_path / "h.jsonl"
    one = History(path)
    one.add(Start("learner", "learner", 1))
    for number in range(1, 1_001):
        one.add(chunk(number))
    for _ in range(200):
        one.add(Entry("duplicate", "w", 1, 5, 5, 1))
    one.close()
    assert len(path.read_text().splitlines()) < 200
    joined = History(path)
    records, damaged = read(path)
    assert damaged == 0
    assert records[1] == Entry("accepted", "w", 1, 1, 1_000, 10, 10_000, 10_005)
    assert records[2] == Entry("duplicate", "w", 1, 5, 5, 200)
    assert joined.before[-1] == End()


def test_other_steps_and_other_starts_are_not_joined(tmp_path):
    """Only what a joined line can say exactly is joined."""
    path = tmp_path / "h.jsonl"
    one = History(path)
    for record in (chunk(1), chunk(2), chunk(3, steps=5), Start("learner", "learner", 2), chunk(4, steps=5)):
        one.add(record)
    History(path)
    assert [r.last for r in read(path)[0] if isinstance(r, Entry)] == [2, 3, 4]


def test_a_torn_line_is_counted_and_healed(tmp_path):
    """A line that a killed process left half written costs itself only."""
    path = tmp_path / "h.jsonl"
    path.write_text(text(chunk(1)) + "\n" + text(chunk(2))[:-4])
    assert read(path) == ([chunk(1)], 1)
    History(path).add(chunk(2))
    assert read(path) == ([chunk(1), chunk(2)], 0)


def test_a_damaged_line_in_the_middle_stays(tmp_path):
    """A line that is none, with others behind it or with its line break, was not torn off by a kill, and is kept."""
    path = tmp_path / "h.jsonl"
    path.write_text(text(chunk(1)) + "\njunk\n" + text(chunk(2)) + "\n")
    held = [chunk(1), Unreadable("junk"), chunk(2)]
    assert read(path) == (held, 0)
    History(path).add(chunk(3))
    assert [*held, chunk(3)] == read(path)[0]
    path.write_text("junk\n")
    assert read(path) == ([Unreadable("junk")], 0)


def test_a_disk_that_refuses_is_said_and_made_good(tmp_path, monkeypatch):
    """While nothing can be written the process goes on, says so, and writes all of it when it can."""
    path = tmp_path / "h.jsonl"
    one = History(path)
    one.add(chunk(1))

    class Full:
        def write(self, line: str) -> None:
            raise OSError(28, "No space left on device")

        def close(self) -> None:
            pass

    monkeypatch.setattr(one, "_file", Full())
    one.add(chunk(2))
    assert "No space left" in one.failure
    one.add(chunk(3))
    assert one.failure == ""
    assert [r.last for r in read(path)[0]] == [3]


def test_a_disk_that_becomes_read_only_stops_nobody(tmp_path, monkeypatch):
    """Where neither writing nor tidying up is possible the process goes on and says so."""
    path = tmp_path / "h.jsonl"
    one = History(path)

    def refuse(*arguments: object, **options: object) -> None:
        raise OSError(30, "Read-only file system")

    def reading(path: Path, mode: str = "r", **options: Any) -> Any:
        return opened(path, mode, **options) if "r" in mode else refuse()

    opened = Path.open
    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", reading)
        patched.setattr(Path, "unlink", refuse)
        monkeypatch.setattr(one, "_file", None)
        one.add(chunk(1))
        assert "Read-only file system" in one.failure
        assert "Read-only file system" in History(path).failure
    one.add(chunk(2))
    assert one.failure == ""
    assert [r.last for r in read(path)[0]] == [2]


def test_a_folder_in_place_of_a_history_stays(tmp_path):
    """Somebody's folder is not put aside as a history would be; that nothing is written is said."""
    folder = tmp_path / "kept"
    folder.mkdir()
    (folder / "theirs").write_text("x")
    one = History(folder)
    one.add(chunk(1))
    assert one.failure
    assert (folder / "theirs").read_text() == "x"
    assert [entry.name for entry in tmp_path.iterdir()] == ["kept"]


def test_a_history_that_cannot_be_read_is_kept_and_said(tmp_path, monkeypatch):
    """What earlier starts wrote is put aside, not overwritten, and the alarm stays while the new history grows."""
    path = tmp_path / "h.jsonl"
    History(path).add(chunk(1))
    written = path.read_text()
    with monkeypatch.context() as patched:
        patched.setattr("eia_sec.common.history.history.MAX_BYTES", 1)
        one = History(path)
    one.add(chunk(2))
    assert one.before == []
    assert "h.jsonl.unreadable" in one.failure
    assert (tmp_path / "h.jsonl.unreadable").read_text() == written
    assert [r.last for r in read(path)[0]] == [2]
    assert History(path).failure == ""


def test_a_history_that_another_process_took_over_is_left_alone(tmp_path):
    """The older writer says so and writes no more: neither into the new file nor over it, not even at its end."""
    path = tmp_path / "h.jsonl"
    old = History(path)
    old.add(chunk(1))
    assert not old.taken_over
    new = History(path)
    new.add(chunk(2))
    assert old.taken_over
    old.add(chunk(9))
    old.close()
    new.close()
    assert "another process writes" in old.failure
    assert read(path)[0] == [chunk(1), chunk(2), End()]
    assert not new.failure


def test_a_failing_disk_does_not_hide_another_writer(tmp_path):
    """A writer that has lost its file to a full disk does not put its own in the place of another one's later."""
    path = tmp_path / "h.jsonl"
    old = History(path)
    old.add(chunk(1))
    old._fail(OSError(28, "no space left"))
    new = History(path)
    new.add(chunk(2))
    old.add(chunk(9))
    assert old.taken_over
    new.close()
    assert read(path)[0] == [chunk(1), chunk(2), End()]


@pytest.mark.parametrize("how", ["removed", "renamed", "folder"])
def test_a_history_that_is_removed_is_written_anew(tmp_path, how):
    """The next record notices, an alarm says so for good, and the file holds every record again."""
    path = tmp_path / "history" / "h.jsonl"
    one = History(path)
    one.add(chunk(1))
    assert one.failure == ""
    if how == "renamed":
        path.rename(path.with_name("elsewhere"))
    else:
        path.unlink()
    if how == "folder":
        path.parent.rmdir()
    one.add(chunk(2))
    assert one.failure == "h.jsonl was removed while in use and has been written anew."
    one.add(chunk(3, steps=4))
    one.close()
    assert (one.failure != "", one.taken_over) == (True, False)
    assert [(r.first, r.last) for r in History(path).before if isinstance(r, Entry)] == [(1, 2), (3, 3)]


def test_a_history_whose_directory_is_gone_is_an_alarm(tmp_path):
    """The run directory itself is not made anew; when it is back, the whole history is written."""
    path = tmp_path / "run" / "history" / "h.jsonl"
    one = History(path)
    one.add(chunk(1))
    (tmp_path / "run").rename(tmp_path / "away")
    one.add(chunk(2))
    assert "could not be written: No such file" in one.failure
    assert not (tmp_path / "run").exists()
    (tmp_path / "away").rename(tmp_path / "run")
    one.add(chunk(3))
    assert "written anew" in one.failure
    assert [(r.first, r.last) for r in History(path).before if isinstance(r, Entry)] == [(1, 3)]
