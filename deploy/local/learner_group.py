"""Starts and ends the learners that follow one on this machine, and says which of them has broken their group."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import GroupError
from eia_sec.common.log import name_process
from eia_sec.common.team import TeamSpec
from eia_sec.deploy.exit_codes import GROUP
from eia_sec.deploy.local.code_options import plugin_options
from eia_sec.deploy.local.learners import LEADER, STORE, Place, meet_on_loopback
from eia_sec.learner.group.following import follow, introduce
from eia_sec.learner.group.process_group import Order, ProcessGroup

SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
END_SECONDS: Final = 5.0
"""Time that followers have to end by themselves."""
CAUSE_SECONDS: Final = 1.0
"""Time in which a follower whose connection has closed is also seen to have ended."""


@contextmanager
def leading(place: Place, config: RunConfig, team: TeamSpec) -> Iterator[ProcessGroup | None]:
    """Lead a group of learners, started here or by torchrun; None for a learner alone.

    Args:
        place: this learner's.
        config: the run.
        team: the layout of the team.

    Raises:
        GroupError: a follower has ended or is silent, or holds other parameters.
    """
    if place.size == 1:
        yield None
        return
    followers: list[subprocess.Popen[bytes]] = []
    group: ProcessGroup | None = None
    with tempfile.TemporaryDirectory(prefix="eia-sec-learners-") as folder:
        try:
            store = None if place.by_torchrun else Path(folder, "store")
            meet_on_loopback(place)
            if store is not None:
                with _signals_blocked():
                    followers = [_follower(rank, place.size, store, config) for rank in range(1, place.size)]
            group = ProcessGroup(0, place.size, store, lambda: _ended(followers, place.size, first=True))
            introduce(group, config, team)
            yield group
            with suppress(GroupError):  # the run is over, whoever has gone meanwhile
                group.order(Order.END)
        except GroupError as error:
            raise GroupError(_cause(followers, place.size) or str(error)) from error
        finally:
            if group is not None:
                group.close()
            _end(followers)


def following(place: Place) -> None:
    """Follow the group's leader until the run ends; once the group has met, signals are the leader's business."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)  # torch waits for the others without a look at Python's handlers
    name_process("learner", f"learner-{place.rank}")
    meet_on_loopback(place)
    group = ProcessGroup(place.rank, place.size, place.store, lambda: _orphaned(place))
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    try:
        follow(group)
    finally:
        group.close()  # else torch's threads may abort the process, which would look like the cause of the group's end


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Let processes that start in this block never see the signals that a leader ends with; it sees them afterwards."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _follower(rank: int, size: int, store: Path, config: RunConfig) -> "subprocess.Popen[bytes]":
    """Start a follower in this process's group, so that a supervisor that ends this process ends it as well."""
    command = [sys.executable, "-P", "-m", "eia_sec.deploy.cli", "learner", *plugin_options(config)]
    places = {STORE: str(store), LEADER: str(os.getpid()), "RANK": str(rank), "WORLD_SIZE": str(size)}
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, env={**os.environ, **places})


def _orphaned(place: Place) -> str:
    """Return a sentence about a leader that has ended, or an empty string."""
    return "the leader has ended." if place.leader and os.getppid() != place.leader else ""


def _ended(followers: Sequence["subprocess.Popen[bytes]"], size: int, *, first: bool = False) -> str:
    """Return a sentence about a follower that has ended, or an empty string.

    Args:
        followers: their processes.
        size: N.
        first: whether to name one as well that another one's end, or the leader's word, has made end.
    """
    codes = {rank: code for rank, process in enumerate(followers, 1) if (code := process.poll()) is not None}
    causes = {rank: code for rank, code in codes.items() if code != GROUP} or (codes if first else {})
    for rank, code in causes.items():
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"learner {rank} of {size} ended with {how}, and the group with it."
    return ""


def _cause(followers: Sequence["subprocess.Popen[bytes]"], size: int) -> str:
    until = time.monotonic() + CAUSE_SECONDS
    while not (found := _ended(followers, size)) and followers and time.monotonic() < until:
        time.sleep(0.02)
    return found


def _end(followers: Sequence["subprocess.Popen[bytes]"]) -> None:
    """Wait for followers to end, and kill those that do not; none is left."""
    until = time.monotonic() + END_SECONDS
    for process in followers:
        try:
            process.wait(max(0.0, until - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
