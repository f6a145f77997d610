"""`python -m research.studies` with its processes: done, stopped, gone on with; and every study at the smoke scale."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from research.studies.bench import Bench
from research.studies.catalogue import STUDIES
from research.studies.command import command
from research.studies.jobs import Records
from research.studies.methods import EIA_SEC
from research.studies.perform import perform
from research.studies.scales import SCALES, SMOKE
from tests.research.studies.tiny_study import TINY
from tests.system.fleet import until

WHOLE = ("results.json", "README.md")


def reproduce(folder: Path, *arguments: str) -> int:
    return command([*arguments, "--write", str(folder), "--records", str(folder / "records")])


def test_a_study_in_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its runs are done by processes, which leave records and nothing else, and a second start finds them all."""
    monkeypatch.setitem(SCALES, "smoke", TINY)
    assert reproduce(tmp_path, "ensemble", "--scale", "smoke", "--plan") == 0
    assert "about" in capsys.readouterr().out
    assert list((tmp_path / "records").glob("*.json")) == []
    assert reproduce(tmp_path, "ensemble", "--scale", "smoke") == 0
    assert all((tmp_path / "smoke" / "ensemble" / name).is_file() for name in WHOLE)
    left = {path.suffix for path in (tmp_path / "records").iterdir() if path.is_file()}
    assert left == {".json", ".safetensors", ".lock"}
    assert list((tmp_path / "records").glob("*.job.json")) == []
    data = json.loads((tmp_path / "smoke" / "ensemble" / "results.json").read_text())
    commands = {run["command"] for method in data["methods"].values() for run in method["runs"]}
    assert commands == {f"python -m research.studies ensemble --scale smoke --write {tmp_path}"}
    capsys.readouterr()
    assert reproduce(tmp_path, "ensemble", "--scale", "smoke") == 0
    assert "runs are there" in capsys.readouterr().out


def test_a_study_that_is_stopped_goes_on(tmp_path: Path) -> None:
    """Ctrl-C ends all processes with code 130 and keeps what is whole; the next start does what is missing alone.

    One record is there beforehand, so that something is whole however soon the signal comes.
    """
    arguments = ["inference", "--scale", "smoke", "--write", str(tmp_path), "--records", str(tmp_path)]
    bench = Bench(SMOKE, Records(tmp_path))
    jobs = [job for stage in STUDIES["inference"].stages(bench) for job in stage]
    perform(jobs[0], bench.records, "before")
    started = subprocess.Popen(
        [sys.executable, "-m", "research.studies", *arguments],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    until(lambda: list(tmp_path.glob("*.job.json")), "a run begins")
    children = psutil.Process(started.pid).children(recursive=True)
    os.kill(started.pid, signal.SIGINT)
    output, _ = started.communicate(timeout=60)
    assert started.returncode == 130
    assert "the same command goes on" in output
    _, alive = psutil.wait_procs(children, timeout=10)
    assert alive == []
    missing = {job.digest for job in bench.records.missing(jobs)}
    assert missing
    assert not (tmp_path / "smoke").exists()
    kept = {job.digest: bench.records.path(job).read_bytes() for job in jobs if job.digest not in missing}
    assert jobs[0].digest in kept
    again = subprocess.run(
        [sys.executable, "-m", "research.studies", *arguments], text=True, capture_output=True, check=False
    )
    assert again.returncode == 0, again.stderr
    assert f"first pieces of {len(missing)} runs that are missing ({len(kept)} are there)" in again.stdout
    assert bench.records.missing(jobs) == []
    assert {name: (tmp_path / f"{name}.json").read_bytes() for name in kept} == kept
    made = {job.digest: (bench.records.get(job) or {})["command"] for job in jobs}
    assert {made[name] for name in missing} == {f"python -m research.studies {' '.join(arguments[:-2])}"}
    assert all((tmp_path / "smoke" / "inference" / name).is_file() for name in WHOLE)


def test_two_starts_do_not_share_the_records(tmp_path: Path) -> None:
    """While one process holds them, another one fails with one sentence."""
    arguments = ["inference", "--scale", "smoke", "--write", str(tmp_path), "--records", str(tmp_path)]
    first = subprocess.Popen(
        [sys.executable, "-m", "research.studies", *arguments], stdout=subprocess.DEVNULL, start_new_session=True
    )
    try:
        until(lambda: list(tmp_path.glob("*.job.json")), "a run begins")
        first.send_signal(signal.SIGSTOP)  # so that it is not done before the other has started
        second = subprocess.run(
            [sys.executable, "-m", "research.studies", *arguments], text=True, capture_output=True, check=False
        )
        assert second.returncode == 2
        assert "in use by another process" in second.stderr
    finally:
        first.send_signal(signal.SIGCONT)
        first.send_signal(signal.SIGTERM)
        first.wait(timeout=60)


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_every_study_at_the_smoke_scale(tmp_path: Path) -> None:
    """All of them end, each with data, pictures and a page; what they share is done once."""
    start = time.monotonic()
    assert reproduce(tmp_path, "all", "--scale", "smoke") == 0
    for name in STUDIES:
        folder = tmp_path / "smoke" / name
        assert all((folder / file).is_file() for file in WHOLE)
        assert list(folder.glob("*.png"))
        assert json.loads((folder / "results.json").read_text())["scale"] == "smoke"
    bench = Bench(SMOKE, Records(tmp_path / "records"))
    assert bench.records.missing(bench.trials(EIA_SEC)) == []
    sys.stdout.write(f"all studies at the smoke scale: {time.monotonic() - start:.0f} s\n")
