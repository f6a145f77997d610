"""Output to a full disk: lines are lost and counted, and neither a run nor an exit code is."""

import errno
import io
import os
import subprocess
import sys

import pytest
from rich.console import Console

from eia_sec.deploy.commands.policies.replay import _apart
from eia_sec.deploy.output import patient_output


class Disk(io.StringIO):
    """A stream on a disk that is full at times."""

    error = 0

    def write(self, text: str) -> int:
        if self.error:
            raise OSError(self.error, "refused")
        return super().write(text)


def test_lines_on_a_full_disk_are_lost_and_counted(monkeypatch):
    """What a console prints meanwhile is missing, the next line says so, and another failure is one."""
    disk = Disk()
    monkeypatch.setattr(sys, "stdout", disk)
    console = Console(file=patient_output(), width=80)
    console.print("one")
    disk.error = errno.ENOSPC
    console.print("two")
    console.print("three")
    disk.error = 0
    console.print("four")
    assert disk.getvalue().splitlines() == ["one", "(2 earlier writes failed: the disk was full)", "four"]
    disk.error = errno.EIO
    with pytest.raises(OSError, match="refused"):
        console.print("five")


@pytest.mark.slow
def test_a_command_whose_output_finds_no_room_says_so():
    """One sentence and exit code 1, and no traceback at the interpreter's end."""
    with open("/dev/full", "wb") as full:
        command = [sys.executable, "-m", "eia_sec.deploy.cli", "farm", "show", "--help"]
        # Whose output is not buffered notices at once; others notice at the end.
        plain = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=plain)
    assert (done.returncode, done.stderr) == (1, "eia-sec: the output cannot be written: No space left on device.\n")


def test_policies_that_are_called_alike_are_distinguished():
    """By the folders of their files, and one that is flown against itself by a number."""
    assert _apart("policy", "greedy", "runs/a/policy.safetensors", "greedy") == ("policy", "greedy")
    both = _apart("policy", "policy", "runs/a/policy.safetensors", "runs/b/policy.safetensors")
    assert both == ("a/policy", "b/policy")
    assert _apart("greedy", "greedy", "greedy", "greedy")[0].endswith("greedy (1)")
