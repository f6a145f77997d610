"""`eia-sec logs --follow`: every new line of every host, over SSH or here, until Ctrl-C; nothing stays behind."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import psutil
import pytest

from eia_sec.deploy.hosts.log_stream import MOST_READ, Follower
from tests.system.fleet import until
from tests.system.hosts import EIA_SEC, OnHosts, fake_ssh, sshd

HOSTS = f"""
[learner]
host = "here"
[hosts.here]
host = "local"
folder = "here"
[hosts.far]
host = "somebody@far"
folder = "far"
command = {json.dumps(EIA_SEC)}
workers = 1
"""


def write(folder: Path, process: str, text: str) -> None:
    """Append to a process's log."""
    path = folder / "logs" / f"{process}.log"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as log:
        log.write(text)


class Command:
    """`eia-sec logs --follow`, with what it has printed so far."""

    def __init__(self, fleet: OnHosts, *words: str) -> None:
        command = [sys.executable, "-m", "eia_sec.deploy.cli", "logs", str(fleet.file), "--follow", *words]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        self.process = subprocess.Popen(command, text=True, env=fleet.environment, **pipes)
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip("\n"))

    def expect(self, *lines: str) -> None:
        """Wait for lines, in any order."""
        until(lambda: set(lines) <= set(self.lines), f"{lines} among {self.lines}")

    def interrupt(self) -> int:
        """Press Ctrl-C; return the exit code."""
        self.process.send_signal(signal.SIGINT)
        code = self.process.wait(20.0)
        self._reader.join()
        return code


@pytest.fixture
def fleet(tmp_path: Path) -> OnHosts:
    """A fleet of a local host and one over a fake SSH client, of whose processes only the logs are there."""
    programs, _ = fake_ssh(tmp_path)
    fleet = OnHosts(tmp_path, HOSTS)
    fleet.environment["PATH"] = f"{programs}:{os.environ['PATH']}"
    write(tmp_path / "here", "learner.learner", "one\ntwo\nthree\n")
    write(tmp_path / "home" / "far", "rollout.far-0", "first\n")
    return fleet


def followers(folder: Path) -> list[list[str]]:
    """Return the command lines of far ends below a folder."""
    found = [process.info["cmdline"] or [] for process in psutil.process_iter(["cmdline"])]
    return [words for words in found if "follow" in words and any(str(folder) in w or w == "far" for w in words)]


def test_new_lines_of_all_hosts_until_ctrl_c(tmp_path, fleet):
    """The last lines come first, then each whole line as it is written, of processes that start later, too."""
    command = Command(fleet, "--lines", "2")
    command.expect("here learner.learner: two", "here learner.learner: three", "far rollout.far-0: first")
    assert "here learner.learner: one" not in command.lines
    write(tmp_path / "here", "learner.learner", "half a ")
    write(tmp_path / "home" / "far", "rollout.far-0", "second\n")
    write(tmp_path / "here", "rollout.late", "begun\n")
    command.expect("far rollout.far-0: second", "here rollout.late: begun")
    write(tmp_path / "here", "learner.learner", "line\n")
    command.expect("here learner.learner: half a line")
    assert len(command.lines) == len(set(command.lines))
    assert command.interrupt() == 0
    until(lambda: not followers(tmp_path), "the end of the far ends")


def test_over_a_real_ssh_server(tmp_path):
    """New lines come while they are written, Ctrl-C ends the far end too, and so does the loss of the connection."""
    far = tmp_path / "far"
    with sshd(tmp_path / "ssh") as options:
        if options is None:
            pytest.skip("a server on loopback needs sshd (openssh-server), ssh-keygen, and to be root")
        fleet = OnHosts(tmp_path, HOSTS)
        fleet.edit('host = "somebody@far"\nfolder = "far"', f'host = "127.0.0.1"\nfolder = {json.dumps(str(far))}')
        fleet.edit("workers = 1", f"workers = 1\nssh = {json.dumps(options)}")
        write(far, "rollout.far-0", "first\n")
        command = Command(fleet)
        command.expect("far rollout.far-0: first")
        write(far, "rollout.far-0", "second\n")
        command.expect("far rollout.far-0: second")
        assert followers(tmp_path)
        assert command.interrupt() == 0
        until(lambda: not followers(tmp_path), "the end of the far end")
        command = Command(fleet)
        command.expect("far rollout.far-0: second")
        for process in psutil.Process(os.getpid()).children(recursive=True):
            if process.name() == "sshd":
                process.kill()
        until(lambda: any(line.startswith("far (lost): far: no connection") for line in command.lines), "the loss")
        until(lambda: not any(str(far) in " ".join(words) for words in followers(tmp_path)), "the end of the far end")
        assert command.interrupt() == 1


def test_only_the_processes_that_are_named(tmp_path, fleet):
    """Other logs are not shown, and a log that does not exist yet is awaited."""
    command = Command(fleet, "--process", "rollout.far-0", "keeper")
    command.expect("far rollout.far-0: first")
    (tmp_path / "here" / "keeper.log").write_text("kept\n")
    command.expect("here keeper: kept")
    assert command.interrupt() == 0
    assert not any("learner" in line for line in command.lines)


def test_a_process_that_left_the_fleet_file_can_be_named(tmp_path, fleet):
    """Its log is still there; of a name that no host knows, nothing is shown but a sentence."""
    write(tmp_path / "here", "rollout.here-3", "gone\n")
    shown = fleet.eia_sec("logs", str(fleet.file), "--process", "rollout.here-3")
    assert shown == "== here rollout.here-3\ngone\n"
    refused = fleet.eia_sec("logs", str(fleet.file), "--process", "rollout.here-3", "rollout.here-4", code=2)
    assert refused.startswith(f"eia-sec: {fleet.file} has no process 'rollout.here-4'; it has keeper, ")


def test_a_host_that_is_lost_is_named_and_the_others_go_on(tmp_path, fleet):
    """Its sentence comes at once and again at the end, with exit code 1."""
    fleet.edit("somebody@far", "unreachable")
    command = Command(fleet)
    command.expect("far (lost): far: no connection: ssh: no route to host", "here learner.learner: three")
    write(tmp_path / "here", "learner.learner", "four\n")
    command.expect("here learner.learner: four")
    assert command.interrupt() == 1
    assert command.lines[-1] == "eia-sec: far: no connection: ssh: no route to host"


def test_a_file_that_is_cut_short_is_read_again(tmp_path):
    """A file that got shorter is a new one; an incomplete line waits, unless it is very long."""
    path = tmp_path / "log"
    follower = Follower(path, 5)
    assert follower.more() == []
    path.write_text("a\nb")
    assert follower.more() == ["a"]
    path.write_text("a\nbc\n")
    assert follower.more() == ["bc"]
    path.write_text("new\n")
    assert follower.more() == ["new"]
    path.write_bytes(b"new\n" + b"x" * (MOST_READ + 1))
    assert [len(line) for line in follower.more()] == [MOST_READ]


def test_a_long_file_begins_with_its_last_lines(tmp_path):
    """However many lines there are, only the wanted ones come, each whole."""
    path = tmp_path / "log"
    path.write_text("".join(f"line {number}\n" for number in range(10_000)))
    follower = Follower(path, 3)
    assert follower.more() == ["line 9997", "line 9998", "line 9999"]
    assert follower.more() == []
