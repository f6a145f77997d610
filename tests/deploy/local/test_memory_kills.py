"""A child that the kernel kills for lack of memory, for real: in a control group with little of it."""

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

import pytest

pytestmark = pytest.mark.slow

LIMIT = 512 * 2**20
HUNGRY = "held = [b'x' * (1 << 24) for _ in range(1 << 12)]"
"""A program that takes 64 GiB, 16 MiB at a time."""
SUPERVISED = """
import sys, time
from pathlib import Path
from eia_sec.deploy.local.supervisor import Supervisor

folder, group, program = map(Path, sys.argv[1:])
(group / "cgroup.procs").write_text("0")
(folder / "hungry.py").write_text(program.read_text())
family = Supervisor(folder / "logs", {"PYTHONPATH": str(folder)}, program="hungry")
family.start("learner", [])
while not family.alarms:
    family.watch()
    time.sleep(0.01)
family.stop()
print(family.alarms[0])
"""


@pytest.fixture
def group():
    """A control group with little memory, in the first or second version; skipped where none can be made."""
    root = Path("/sys/fs/cgroup")
    first = root / "memory"
    path = (first if first.is_dir() else root) / f"eia-sec-{uuid4().hex[:8]}"
    try:
        path.mkdir()
    except OSError as error:
        pytest.skip(f"no control group can be made here: {error}")
    try:
        (path / ("memory.limit_in_bytes" if first.is_dir() else "memory.max")).write_text(str(LIMIT))
        if (swap := path / "memory.swap.max").exists():
            swap.write_text("0")
        yield path
    except OSError as error:
        pytest.skip(f"its memory cannot be limited here: {error}")
    finally:
        with suppress(OSError):
            path.rmdir()


def test_the_alarm_names_the_kernel_and_the_memory(group, tmp_path):
    """The words are those of the kernel's counters, with the group's limit."""
    program = tmp_path / "program.txt"
    program.write_text(HUNGRY, encoding="utf-8")
    command = [sys.executable, "-c", SUPERVISED, str(tmp_path), str(group), str(program)]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert "learner ended with signal 9" in done.stdout
    assert "the kernel killed it, because the memory of its control group ran out" in done.stdout
    assert "of 0.5 GiB" in done.stdout
