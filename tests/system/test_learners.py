"""`eia-sec train --learners 2`: kill -9 of any process, and every step is accounted for."""

import json
import signal
import subprocess
import sys
from contextlib import suppress

import psutil
import pytest

from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.monitor.audit import audit
from tests.system.fleet import PRESET, RUN, on_policy, until
from tests.system.training import Training, gone

pytestmark = pytest.mark.slow

ENDLESS = on_policy("eia-ppo").replace("episodes = 8", "episodes = 1000000").replace("cycle = 2", "cycle = 200")
PATIENCE = 300.0
"""Seconds in which a busy machine starts a learner with its followers."""


class Learners(Training):
    """A run with two learners and two workers."""

    def records(self, kind):
        """Return the learner's records of a kind."""
        path = self.run_dir / "metrics.jsonl"
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        return [json.loads(line) for line in lines if line.startswith(f'{{"kind": "{kind}"') and line.endswith("}")]

    def newest(self, name):
        """Return a number of the newest status; 0 before the first."""
        return (self.records("status") or [{}])[-1].get(name, 0)

    def found(self, *words):
        """Return the running processes whose command has these words, and of learners that of the leader or not."""
        leader, running = "--learners" in words, []
        for process in self.children():
            with suppress(psutil.NoSuchProcess):
                command = process.cmdline()
                wanted = set(words) <= set(command) and process.status() != psutil.STATUS_ZOMBIE
                if wanted and ("learner" not in words or ("--learners" in command) == leader):
                    running.append(process)
        return running

    def one(self, *words):
        """Wait for such a process, and return it."""
        return until(lambda: self.found(*words), f"a process {words}", PATIENCE)[0]

    def learns(self):
        """Wait until the run has learned more."""
        before = self.newest("updates")
        until(lambda: self.newest("updates") > before + 40, "updates", PATIENCE)


def test_a_run_survives_the_death_of_each_process(tmp_path):
    """Leader, follower, worker and coordinator are killed in turn; the run goes on, and its account closes."""
    training = Learners(tmp_path, ENDLESS)
    training.start("--learners", "2", "--workers", "2", "--no-report")
    try:
        training.learns()
        assert training.newest("group")["learners"] == 2
        starts = 0
        for words in (("learner",), ("learner", "--learners"), ("rollout", "--name", "0"), ("elite",)):
            process = training.one(*words)
            process.kill()
            if words[0] == "learner":
                starts += 1
                until(lambda starts=starts: len(training.records("resume")) == starts, f"resume {starts}", PATIENCE)
            else:
                until(lambda p=process, w=words: [f for f in training.found(*w) if f.pid != p.pid], "another", PATIENCE)
            training.learns()
        log = (training.run_dir / "logs" / "learner.log").read_text(encoding="utf-8")
        assert "eia-sec: learner 1 of 2 ended with signal 9, and the group with it." in log
        assert "ended with exit code 3; restarting it" in training.output.read_text(encoding="utf-8")
        processes = training.children()
        training.process.send_signal(signal.SIGINT)
        assert training.wait() == 0
        assert gone(processes)
    finally:
        if training.process is not None and training.process.poll() is None:
            training.process.kill()
    found = audit(training.run_dir)
    assert found.named() == []
    assert found.starts == 3
    status = training.records("status")[-1]
    assert status["ledger"]["unexplained"] == 0
    assert status["ledger"]["produced"] == sum(account["produced"] for account in status["ledgers"].values())
    assert status["environment_steps"] == found.steps["accepted"]


def test_learners_that_torchrun_starts(tmp_path):
    """Two learners that torchrun has started finish a run together."""
    run_dir, where = tmp_path / "run", str(free_endpoint())
    (tmp_path / "wanted.toml").write_text(on_policy("ippo"), encoding="utf-8")
    ours = [sys.executable, "-m", "eia_sec.deploy.cli"]
    learner = [*ours, "learner", "--run", RUN, "--listen", where, "--preset", PRESET, "--run-dir", str(run_dir)]
    learner += ["--config", str(tmp_path / "wanted.toml")]
    met = ["--master-addr", "127.0.0.1", "--master-port", str(free_endpoint().port)]
    torchrun = [sys.executable, "-m", "torch.distributed.run", *met, "--nproc-per-node", "2", "--no-python"]
    worker = [*ours, "rollout", "--run", RUN, "--connect", where, "--name", "0", "--patience", str(PATIENCE)]
    with subprocess.Popen([*torchrun, "--", *learner]) as group, subprocess.Popen(worker) as flying:
        try:
            assert group.wait(PATIENCE) == 0
            assert flying.wait(PATIENCE) == 0
        finally:
            group.terminate()
            flying.terminate()
    records = [json.loads(line) for line in (run_dir / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]
    newest = [record for record in records if record["kind"] == "status"][-1]
    assert (newest["state"], newest["group"]["learners"]) == ("finished", 2)
    assert newest["updates"] > 0
    assert audit(run_dir).named() == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--learners", "2", "--lockstep"), "a lockstep run has one learner"),
        (("--learners", "0"), "learners"),
        (("--learners", "2", "--algorithm.memory", "gru", "--algorithm.precision", "float32"), "without memory"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_starts(tmp_path, options, said):
    """It is one sentence and exit code 2, and no run directory is left."""
    training = Training(tmp_path, ENDLESS)
    training.start(*options)
    assert training.wait() == 2
    text = training.output.read_text(encoding="utf-8")
    assert said in text
    assert text.count("\n") == 1
    assert not training.run_dir.exists()
