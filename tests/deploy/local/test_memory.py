"""Memory that large messages leave behind stays with the process."""

import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
from eia_sec.deploy.local.memory import keep_freed_memory
if sys.argv[1] == "keep" and not keep_freed_memory():
    sys.exit(3)
def messages():
    for _ in range(50):
        blocks = [b"x" * 3_000_000 for _ in range(4)]
messages()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
messages()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def page_faults(how):
    done = subprocess.run([sys.executable, "-c", FAULTS, how], check=False, capture_output=True, text=True)
    if done.returncode == 3:
        pytest.skip("this C library has no such setting")
    done.check_returncode()
    return int(done.stdout)


def test_pages_are_not_taken_anew_for_every_message():
    """Without it each round of large blocks is given back and faulted in again."""
    assert page_faults("keep") * 10 < page_faults("leave")
