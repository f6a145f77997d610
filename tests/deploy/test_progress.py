"""How far work has come: lines without a terminal, and nothing on standard output."""

import errno
import io
import itertools
import sys
import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from eia_sec.deploy.progress import part, progress


class Full(io.StringIO):
    """A stream on a full disk."""

    tried = 0

    def write(self, text: str) -> int:
        """Refuse."""
        self.tried += 1
        raise OSError(errno.ENOSPC, "no space left")


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
    """A line that cannot be written is left out, and was tried."""
    clock = seconds(60.0)
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    full = Full()
    monkeypatch.setattr(sys, "stderr", full)
    with progress("evaluating") as tell:
        tell(0.5)
    assert full.tried == 1


def test_parts_add_up() -> None:
    """The second of four equal parts begins at a quarter."""
    told: list[float] = []
    share = part(told.append, 1, 4)
    share(0.0)
    share(1.0)
    assert told == [0.25, 0.5]
