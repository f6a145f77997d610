"""The benchmark of updates: what it prints, what it counts, and what it refuses."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from eia_sec.common.config import EiaSecConfig
from eia_sec.common.errors import UsageError
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.exit_codes import USAGE, run_command
from eia_sec.learner.off_policy.engine import Engine
from eia_sec.learner.off_policy.inputs import critic_width
from eia_sec.learner.registry import OFF_POLICY
from research.benchmarks import learner
from research.benchmarks.peers.catalogue import ROOT
from tests.learner.off_policy.test_engine import batches

TEAM = TeamSpec((GroupSpec("a", 2, 3, 2), GroupSpec("b", 1, 6, 1)))
SMALL = EiaSecConfig(hidden=5, batch=7)

# Multiplications of one row in TEAM's networks with layers of 5, by pencil. A local critic of a sees 3 + 2 numbers, one
# of b 6 + 1, a joint one 2 * (3 + 2) + 7 = 17. So a critic goes forward with
#     5*5 + 5*5 + 5 = 55 (a)    7*5 + 5*5 + 5 = 65 (b)    17*5 + 5*5 + 5 = 115 (joint),
# its weights' gradient takes as many, what goes through its upper layers 5 + 25 = 30, and what goes down to the action
# 5 + 25 + 2*5 = 40 (a) or 5 + 25 + 5 = 35 (b). An actor goes forward with 3*5 + 25 + 5*2 = 50 (a) or 30 + 25 + 5 = 60
# (b), its weights' gradient takes as many, and what goes through its upper layers 10 + 25 = 35 (a) or 5 + 25 = 30 (b);
# a Gaussian one, whose head has twice the columns, 60 and 45 (a) or 65 and 35 (b).
#
# Critics learn by target, prediction, weights and what goes through: 3*55 + 30 = 195 (a), 3*65 + 30 = 225 (b),
# 3*115 + 30 = 375 (joint). Actors choose next actions, and step: forward, critic forward, down to the action, weights,
# through:  a  50 and 50 + 55 + 40 + 50 + 35 = 230    b  60 and 60 + 65 + 35 + 60 + 30 = 250    with local critics
#           a  50 and 50 + 115 + 40 + 50 + 35 = 290   b  60 and 60 + 115 + 35 + 60 + 30 = 300   with joint ones
MULTIPLICATIONS = {
    "base": 2 * (195 + 50 + 230) + (225 + 60 + 250),
    # each of two members learns as a local critic does, and the actors maximise it, forward and down
    "eia-sec": 2 * (3 * 195 + 50 + 230 + 2 * (55 + 40)) + (3 * 225 + 60 + 250 + 2 * (65 + 35)),
    "maddpg": 2 * (375 + 50 + 290) + (375 + 60 + 300),
    # two critics learn, and in every second update the actors maximise one of them
    "matd3": 2 * (2 * 375 + 50 + 290 / 2) + (2 * 375 + 60 + 300 / 2),
    # two critics learn and both are maximised, by Gaussian actors
    "masac": 2 * (2 * 375 + 60 + 60 + 2 * (115 + 40) + 60 + 45) + (2 * 375 + 65 + 65 + 2 * (115 + 35) + 65 + 35),
}


@pytest.mark.parametrize("name", learner.TIMED)
def test_operations_are_those_of_a_count_by_hand(name):
    """Each multiplication comes with an addition, in each of the batch's rows."""
    assert learner.operations(learner.configured(name, SMALL), TEAM) == 2 * 7 * MULTIPLICATIONS[name]


def beyond_the_action(config):
    """Return the operations by which torch takes an actor's gradient down to all inputs of its critics."""
    algorithm, total = OFF_POLICY[config.name], 0.0
    for kind, group in enumerate(TEAM.groups):
        others = critic_width(TEAM, kind, config.joint_critics) - group.action_size
        maximised = algorithm.objective_critics / algorithm.actor_period(config)
        members = config.ensemble_members if config.uses_ensemble else 0
        total += group.count * (maximised + members) * others * config.hidden
    return 2.0 * config.batch * total


@pytest.mark.parametrize("name", learner.TIMED)
def test_operations_are_those_that_torch_counts(name):
    """The engine's products by torch are those and what goes down beyond the actions."""
    config = learner.configured(name, replace(SMALL, hidden=64))
    engine, updates = Engine(config, TEAM, 0, cores=0), 6
    with FlopCounterMode(display=False) as counter:
        for batch in batches(TEAM, config, updates, torch.float32):
            engine.update(batch)
    counted = counter.get_total_flops() / updates
    wanted = learner.operations(config, TEAM) + beyond_the_action(config)
    assert 1.0 <= counted / wanted < 1.005


def run(*arguments, **environment):
    command = [sys.executable, "-m", "research.benchmarks.learner", *arguments]
    return subprocess.run(
        command, cwd=ROOT, env=os.environ | environment, check=False, capture_output=True, text=True, timeout=300
    )


def test_json_is_as_promised():
    """`updates`, `decide_us` and `on_policy` have the keys that others read, for each case that was asked for."""
    done = run("--updates", "2", "--repeats", "1", "--widths", "16", "--algorithms", "eia-sec", "matd3", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert [(line["algorithm"], line["width"], line["agents"], line["threads"]) for line in found["updates"]] == [
        ("eia-sec", 16, 12, 1),
        ("matd3", 16, 12, 1),
    ]
    assert all(line["ms"] > 0 and line["limit_ms"] > 0 for line in found["updates"])
    assert set(found["decide_us"]) == {"6", "12", "16", "20", "24", "96"}
    assert all(microseconds > 0 for microseconds in found["decide_us"].values())
    learned = found["on_policy"]
    assert (learned["preset"], learned["algorithm"], learned["width"], learned["threads"]) == (
        "instant",
        "ippo",
        64,
        1,
    )
    assert 0.0 < learned["limit_us"] < learned["updates_us"]


def test_threads_that_are_not_there_are_refused():
    """With one thread for numba the engine computes on one core, so nothing is measured on two."""
    done = run("--threads", "1", "2", "--json", NUMBA_NUM_THREADS="1")
    assert (done.returncode, done.stdout) == (USAGE, "")
    assert done.stderr == "eia-sec: --threads 2 cannot be: numba, by NUMBA_NUM_THREADS, gives 1.\n"
    with pytest.raises(UsageError, match="takes 1 or more"):
        learner.take_threads(0)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--device", "cuda"], "--device cuda needs a CUDA device, and torch finds none."),
        (["--redraw"], "--redraw takes the folder from --growth."),
    ],
)
def test_what_cannot_be_is_refused(arguments, sentence, monkeypatch, capsys):
    """One sentence and exit code 2."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(sys, "argv", ["learner", *arguments])
    assert run_command(learner.main) == USAGE
    assert capsys.readouterr().err == f"eia-sec: {sentence}\n"


@pytest.mark.parametrize("name", learner.TIMED)
def test_bursts_are_whole_cycles(name):
    """A burst has two updates, so that both kinds of MATD3's are in it."""
    assert learner.burst_of(learner.configured(name)) == 2


class Clock:
    """Seconds that pass only when the test says so, and work that is given to a device and not yet done."""

    def __init__(self, monkeypatch):
        self.now = self.pending = 0.0
        monkeypatch.setattr(learner.time, "perf_counter", lambda: self.now)
        monkeypatch.setattr(torch.cuda, "synchronize", self.settle)

    def give(self, seconds):
        self.pending += seconds

    def settle(self):
        self.now, self.pending = self.now + self.pending, 0.0


@pytest.mark.parametrize("device", learner.DEVICES)
def test_an_update_is_timed_in_bursts_until_the_device_is_done(device, monkeypatch):
    """Every second update being dearer, a burst has one of each; on an accelerator its work is waited for."""
    clock, done = Clock(monkeypatch), []

    def train(updates):
        for _ in range(updates):
            clock.give(0.003 if len(done) % 2 else 0.001)
            done.append(device)
        if device == "cpu":
            clock.settle()

    engine = SimpleNamespace(cores=3 if device == "cpu" else 0)
    monkeypatch.setattr(learner, "filled_trainer", lambda *_: SimpleNamespace(train=train, team=TEAM, engine=engine))
    monkeypatch.setattr(learner, "matrix_speed", lambda where: {"cpu": 1e9, "cuda": 1e12}[where])
    line = learner.measure(replace(SMALL, ensemble=False), 8, device=device)
    assert line["ms"] == 2.0
    assert (line["burst"], line["device"]) == (2, device)
    assert line["threads"] == (3 if device == "cpu" else torch.get_num_threads())
    assert line["gflops"] == (1.0 if device == "cpu" else 1000.0)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")
@pytest.mark.parametrize("name", ["eia-sec", "matd3"])
def test_updates_are_timed_on_cuda(name):
    """The engine's captured updates and the limit are those of the device."""
    line = learner.measure(learner.configured(name), 4, capacity=8192, device="cuda")
    assert line["device"] == "cuda"
    assert line["ms"] > line["limit_ms"] > 0
