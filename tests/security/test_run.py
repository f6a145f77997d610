"""A whole run with certificates: it finishes, a process that is not on the list says so, and nothing is unpickled."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from eia_sec.common.transport.endpoint import free_endpoint
from tests.system.fleet import PRESET, RUN, TINY

SECONDS = 120.0


class Audited:
    """`eia-sec` processes under the audit hook."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, *arguments: str) -> None:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
        with (self.folder / f"{name}.log").open("wb") as log:
            self.running[name] = subprocess.Popen(
                [sys.executable, "-m", "tests.security.audited", *arguments], stdout=log, stderr=log, env=environment
            )

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text(errors="replace")

    def await_line(self, name: str, text: str) -> bool:
        deadline = time.monotonic() + SECONDS
        while text not in self.log(name) and time.monotonic() < deadline:
            time.sleep(0.1)
        return text in self.log(name)

    def close(self) -> None:
        for process in self.running.values():
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
            process.wait(10.0)


@pytest.fixture
def audited(tmp_path: Path) -> Iterator[Audited]:
    fleet = Audited(tmp_path)
    yield fleet
    fleet.close()


def test_a_run_with_certificates_finishes_and_denies_who_is_not_listed(audited, keys_folder, tmp_path):
    """All finish, a late monitor sees them, a worker that was struck says that it is denied; none unpickles."""
    (tmp_path / "wanted.toml").write_text(TINY)
    endpoint, tls = str(free_endpoint()), lambda name: ("--tls", str(keys_folder / name))
    joining = ("--run", RUN, "--connect", endpoint)
    wanted = ("--preset", PRESET, "--config", str(tmp_path / "wanted.toml"))
    learner = ("--run", RUN, "--listen", endpoint, *wanted)
    audited.start("learner", "learner", *learner, "--run-dir", str(tmp_path / "run"), *tls("learner.learner"))
    audited.start("unlisted", "rollout", *joining, *tls("rollout.unlisted"))
    assert audited.await_line("unlisted", "denied: "), audited.log("unlisted") + audited.log("learner")
    for part in ("the learner of run test is alive", "rollout.unlisted (certificate", "access list denies"):
        assert part in audited.log("unlisted")
    # The learner has published reports for a while; the monitor's subscription covers all names of the run.
    audited.start("monitor", "monitor", *joining, "--refresh", "0.2", *tls("monitor.m"))
    assert audited.await_line("monitor", "0 of 8 episodes"), audited.log("monitor")
    audited.start("elite", "elite", *joining, *tls("elite.coordinator"))
    audited.start("worker", "rollout", *joining, *tls("rollout.a"))
    for name in ("learner", "elite", "worker"):
        assert audited.running[name].wait(SECONDS) == 0, audited.log(name)
        assert "UNPICKLED" not in audited.log(name)
        assert "denied" not in audited.log(name)
    assert "denied" not in audited.log("monitor").partition("0 of 8 episodes")[2]


@pytest.mark.parametrize(
    ("code", "seen"),
    [
        ("p.loads(p.dumps(__import__('fractions').Fraction))", "pickle.find_class ('fractions', 'Fraction')"),
        ("p.loads(p.dumps([1, 2.5]))", "pick" + "le.loads"),
        ("p.load(__import__('io').BytesIO(p.dumps([1])))", "pick" + "le.load"),
        ("m = importlib.import_module('marsh' + 'al'); m.loads(m.dumps([1]))", "marshal.loads"),
        ("importlib.import_module('shel' + 've')", "import shelve"),
    ],
)
def test_the_watch_sees_each_way_to_unpickle(code, seen):
    """The watch is not blind: a class, plain numbers, marshalled objects and a shelf are all logged."""
    prepare = "import tests.security.audited, importlib; p = importlib.import_module('pick' + 'le'); "
    done = subprocess.run([sys.executable, "-c", prepare + code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert f"UNPICKLED {seen}" in done.stderr


def test_the_watch_is_silent_about_imports():
    """Importing compiled modules, which Python itself unmarshals, is not logged."""
    code = "import tests.security.audited, decimal, csv, email.parser"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
