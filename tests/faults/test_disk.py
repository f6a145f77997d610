"""Full and read-only disks: training goes on, the checkpoint before stands, and an alarm says so."""

import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from eia_sec.learner.checkpoint import files
from tests.faults.tools.harness import FaultRun, record_result
from tests.system.fleet import until

MOUNT = Path("/bin/mount")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 12 MiB, where this may be made."""
    folder = tmp_path / "run"
    folder.mkdir()
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", str(folder)], check=False, stderr=-3)
    if made.returncode != 0:
        pytest.skip("making a small file system needs more rights")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=False)


def fill(path: Path, piece: int = 65_536) -> int:
    """Write to the end of a file until the disk is full; return the bytes."""
    size = 0
    with path.open("ab", buffering=0) as file:
        while True:
            try:
                size += file.write(bytes(piece))
            except OSError:
                return size


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Make a folder a mount of its own that nobody may write to; files that are open elsewhere stay so."""
    subprocess.run(["mount", "--bind", str(folder), str(folder)], check=True)
    try:
        subprocess.run(["mount", "-o", "remount,bind,ro", str(folder)], check=True)
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def alarms(fleet: FaultRun) -> str:
    """Return what the learner has logged as alarms."""
    return "\n".join(line for line in fleet.log("learner").splitlines() if "ALARM" in line)


def test_a_full_disk(tmp_path, small_disk):
    """The learner trains on while the disk is full, says so, and the checkpoint before loads; later ones follow.

    Its log lies on the same disk, as under `eia-sec train`: no line of it can be written either.
    """
    fleet, log = FaultRun(tmp_path), small_disk / "logs" / "learner.log"
    log.parent.mkdir()
    (tmp_path / "learner.log").symlink_to(log)
    try:
        fleet.learner()
        fleet.start("rollout-0", "rollout", "--run", "test", "--connect", str(fleet.endpoint), "--name", "0")
        folder = small_disk / "checkpoints"
        until(lambda: list(folder.glob("checkpoint-*")), "a checkpoint", 120.0)
        until(fleet.taken, "chunks", 120.0)
        with fleet.metrics("learner", "learner") as heard:
            # A checkpoint half written when the disk filled up is removed, which frees its space: fill that, too.
            fill_up = lambda: fill(small_disk / "ballast") + fill(log, 1)  # noqa: E731  # asked again and again
            size = fill_up()
            alarms = lambda: {text for report in heard() for text in report["alarms"]}  # noqa: E731  # asked twice
            missing = lambda: [text for text in alarms() if "no checkpoint could be written" in text]  # noqa: E731  # one expression
            until(lambda: not fill_up() and missing(), "an alarm", 60.0)
            before = len(heard())
            trained = lambda: [report["updates"] for report in heard()[before:]]  # noqa: E731  # asked twice
            goes_on = lambda: len(trained()) > 4 and trained()[-1] > trained()[0]  # noqa: E731  # one expression
            until(lambda: not fill_up() and goes_on(), "training on a full disk", 60.0)
            complaints = len(alarms())
        found = files.load_latest(folder)
        assert found is not None
        steps = found.manifest["trainer"]["environment_steps"]
        (small_disk / "ballast").unlink()
        started = time.monotonic()
        newest = lambda: files.load_latest(folder).manifest["trainer"]["environment_steps"]  # noqa: E731  # asked twice
        until(lambda: newest() > steps, "a new checkpoint with more steps", 60.0)
        recovery = round(time.monotonic() - started, 2)
        fleet.end()
        assert fleet.audit().clean
        assert "could not be written) " in fleet.log("learner")
        record_result("full_disk", ballast_bytes=size, alarms=complaints, seconds_to_recover=recovery)
    finally:
        fleet.close()


@pytest.mark.nightly
def test_a_disk_that_becomes_read_only(tmp_path, small_disk):
    """The same when nothing can be written at all any more."""
    fleet = FaultRun(tmp_path)
    try:
        fleet.learner()
        fleet.start("rollout-0", "rollout", "--run", "test", "--connect", str(fleet.endpoint), "--name", "0")
        folder = small_disk / "checkpoints"
        until(lambda: list(folder.glob("checkpoint-*")), "a checkpoint", 120.0)
        until(fleet.taken, "chunks", 120.0)
        with read_only(folder):
            until(lambda: "Read-only file system" in alarms(fleet), "an alarm", 60.0)
            found = files.load_latest(folder)
            assert found is not None
            before = fleet.taken()
            until(lambda: fleet.taken() > before, "further chunks")
        steps = found.manifest["trainer"]["environment_steps"]
        newest = lambda: files.load_latest(folder).manifest["trainer"]["environment_steps"]  # noqa: E731  # asked twice
        until(lambda: newest() > steps, "a new checkpoint with more steps", 60.0)
        fleet.end()
        assert fleet.audit().clean
    finally:
        fleet.close()
