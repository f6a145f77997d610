"""The benchmark of checkpoints writes a result that the page can show."""

import json
import re
import subprocess
import sys

from eia_sec.deploy.reports.provenance import PACKAGES
from research.benchmarks.peers.catalogue import ROOT
from research.pages.measurements import NOT_MEASURED, PAUSE_AIM, checkpoint_block, measured


def test_a_result_names_its_origin_and_is_shown(tmp_path):
    """With a small replay buffer: every result is there, and the page's block is made of them."""
    file = tmp_path / "research" / "results" / "checkpoint.json"
    file.parent.mkdir(parents=True)
    small = ("--checkpoints", "2", "--width", "16", "--capacity", "4200", "--folder", str(tmp_path))
    command = [sys.executable, "-m", "research.benchmarks.checkpoint", *small, "--json", "--write", str(file)]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    printed, written = json.loads(done.stdout), json.loads(file.read_text(encoding="utf-8"))
    assert printed.items() <= written.items()
    assert set(written["packages"]) == set(PACKAGES)
    assert written["command"].startswith("python -m research.benchmarks.checkpoint --checkpoints 2")
    assert (written["rows"], written["checkpoints"], written["width"]) == (4200, 2, 16)
    assert written["bytes"] > 4 * written["rows"] * written["row_numbers"]
    for name in ("turn_ms_{}_writing", "turn_ms_{}_else", "pause_ms_{}"):
        assert 0.0 < written[name.format("median")] <= written[name.format("most")]
    text = measured("checkpoint", tmp_path)
    assert NOT_MEASURED not in text
    assert f"| training stopped | {written['pause_ms_median']:.1f} | {written['pause_ms_most']:.1f} |" in text
    assert list(tmp_path.iterdir()) == [tmp_path / "research"]


def test_the_verdict_is_that_of_the_longest_pause():
    """One checkpoint that stops the training for too long is one too many."""
    names = ("turn_ms_median_writing", "turn_ms_most_writing", "turn_ms_median_else", "turn_ms_most_else", "copy_ms")
    data = {**dict.fromkeys(names, 7.0), "command": "x", "commit": "y", "write_seconds_median": 1.0, "bytes": 2**21}
    data |= {"checkpoints": 2, "agents": 12, "width": 64, "rows": 9, "cores": 2, "pause_ms_median": 1.0}
    verdicts = [checkpoint_block({**data, "pause_ms_most": most}) for most in (PAUSE_AIM, PAUSE_AIM + 0.5)]
    assert [re.findall(r"at most; (.+)\.", text) for text in verdicts] == [["met: 50.0 ms"], ["not met: 50.5 ms"]]
