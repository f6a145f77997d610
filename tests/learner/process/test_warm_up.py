"""A learner whose updates are compiled before anybody waits for it."""

import json
import os
import subprocess
import sys

import pytest

from eia_sec.deploy.local.threads import thread_environment

# What a run calls after its warm-up that was not compiled in it; in a process of its own, where nothing was before.
COUNT = """
import json, sys
from dataclasses import replace
from numba.core.dispatcher import Dispatcher
from eia_sec.common.config.presets import preset
from eia_sec.learner.process.warm_up import warm_up
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from eia_sec.rollout.worker.collector import Collector

def compiled():
    functions = {}
    for name, module in list(sys.modules.items()):
        if name.startswith("eia_sec.learner"):
            functions |= {f"{name}.{n}": f for n, f in vars(module).items() if isinstance(f, Dispatcher)}
    return {name: len(function.signatures) for name, function in functions.items()}

base = preset("eia-sec").with_algorithm(sys.argv[1])
config = replace(base, replay=replace(base.replay, warmup_steps=0))
collector = Collector(config, "0", 0)
before = compiled()
if sys.argv[2] == "warmed up":
    warm_up(config, collector.team)
warmed = compiled()
trainer = OffPolicyTrainer(config, collector.team)
while trainer.updates < 40:
    trainer.absorb(collector.collect(trainer.actors(), 0.3, False))
    trainer.train(trainer.updates_due())
print(json.dumps([sum(before.values()), sum(warmed.values()), sum(compiled().values()), trainer.actors().digest()]))
"""


def counted(algorithm: str, how: str) -> list[object]:
    command, environment = [sys.executable, "-c", COUNT, algorithm, how], {**os.environ, **thread_environment(1)}
    ended = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300, env=environment)
    found: list[object] = json.loads(ended.stdout.splitlines()[-1])
    return found


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["eia-sec", "matd3", "masac"])
def test_a_warm_up_compiles_what_a_run_calls_and_changes_nothing_of_it(algorithm: str) -> None:
    """Updates after a warm-up find all compiled, and lead to the same weights as without it."""
    before, warmed, after, digest = counted(algorithm, "warmed up")
    nothing, still_nothing, without, same = counted(algorithm, "unprepared")
    assert before == nothing == still_nothing == 0
    assert 0 < warmed == after
    assert without > 0  # how many depends on the cache on disk: what is read from there brings no inner functions along
    assert digest == same
