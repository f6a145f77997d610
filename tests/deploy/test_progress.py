"""How far work has come and what is waited for: lines without a terminal, and nothing on standard output."""

import itertools
import sys
import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from eia_sec.deploy.progress import Countdown, part, progress


def seconds(step: float) -> Iterator[float]:
    """Yield times that lie this far apart."""
    return itertools.count(0.0, step)


def test_long_work_prints_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every ten seconds of work, on standard error alone; the end needs none."""
    clock = seconds(4.0)
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    with progress("evaluating") as tell:
        for share in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1.0, 1.0, 1.0):
            tell(share)
    said = capsys.readouterr()
    assert (said.out, said.err.splitlines()) == ("", ["evaluating: 30%", "evaluating: 60%"])


def test_quick_work_prints_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    """Scripts read what commands print."""
    with progress("evaluating") as tell:
        tell(0.5)
    assert capsys.readouterr() == ("", "")


def test_work_goes_on_where_standard_error_is_full(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line that cannot be written is left out."""
    clock, tried = seconds(60.0), []

    def full(text: str) -> None:
        tried.append(text)
        raise OSError("no space left")

    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    with progress("evaluating") as tell, monkeypatch.context() as changed:
        changed.setattr(sys, "stderr", SimpleNamespace(write=full))
        tell(0.25)
        tell(0.5)
    assert tried == ["evaluating: 25%\n", "evaluating: 50%\n"]


def test_parts_add_up() -> None:
    """The second of four equal parts begins at a quarter."""
    told: list[float] = []
    share = part(told.append, 1, 4)
    share(0.0)
    share(1.0)
    assert told == [0.25, 0.5]


def test_a_wait_says_how_long_it_may_take(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """After a second, and again every ten; a wait that is over at once says nothing."""
    clock = seconds(1.0)
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    answers = itertools.chain([True] * 14, [False])
    with Countdown("a listener", 30.0, lambda: next(answers)) as waits:
        while waits():
            pass
    assert capsys.readouterr().err.splitlines() == [
        "waiting for a listener: 29 s left",
        "waiting for a listener: 19 s left",
    ]
    with Countdown("a listener", 0.0, lambda: False) as waits:
        assert not waits()
    assert capsys.readouterr().err == ""
