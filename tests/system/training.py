"""One `eia-sec train` as a process, for tests."""

import json
import subprocess
import sys
from pathlib import Path

import psutil

from tests.system.fleet import PRESET


class Training:
    """One `eia-sec train` process with its run directory."""

    def __init__(self, directory: Path, toml: str) -> None:
        self.config = directory / "wanted.toml"
        self.config.write_text(toml, encoding="utf-8")
        self.run_dir = directory / "run"
        self.output = directory / "output.txt"
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, *options: str, configured: bool = True) -> None:
        """Start it, with or without the configuration file."""
        command = [sys.executable, "-m", "eia_sec.deploy.cli", "train", "--run-dir", str(self.run_dir)]
        preset = [] if "--preset" in options else ["--preset", PRESET]
        command += [*preset, "--config", str(self.config), *options] if configured else options
        with self.output.open("ab") as output:
            self.process = subprocess.Popen(command, stdout=output, stderr=output)

    def wait(self, seconds: float = 120.0) -> int:
        """Return its exit code."""
        assert self.process is not None
        return self.process.wait(seconds)

    def children(self) -> list[psutil.Process]:
        """Return the processes that it started."""
        assert self.process is not None
        return psutil.Process(self.process.pid).children(recursive=True)

    def episodes(self) -> int:
        """Return the number of episodes that are recorded."""
        path = self.run_dir / "metrics.jsonl"
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        return max((json.loads(line).get("episodes", 0) for line in lines if line.endswith("}")), default=0)


def gone(processes: list[psutil.Process]) -> bool:
    """Return whether all of them have ended."""
    return not any(p.is_running() and p.status() != psutil.STATUS_ZOMBIE for p in processes)
