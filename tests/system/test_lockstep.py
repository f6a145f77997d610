"""Distribution changes nothing: in lockstep the processes end with the weights of a run inside one process."""

import hashlib
from pathlib import Path

from eia_sec.common.config.files import from_toml
from eia_sec.common.policy_file import load_policy
from eia_sec.deploy.local.in_process import train_in_process
from tests.system.fleet import TINY, Processes, configured


def test_lockstep_is_bit_equal_to_one_process(processes: Processes) -> None:
    """After eight episodes with three imitation events the SHA-256 over all actors is the same."""
    processes.coordinator()
    processes.worker()
    processes.learner("--lockstep")
    assert processes.wait("learner") == 0
    alone = train_in_process(configured())
    assert alone.events == 3
    (end,) = processes.records("end")
    assert end["state"] == "finished"
    assert end["digest"] == alone.actors().digest()
    actors, _ = load_policy(processes.directory / "run" / "policy.safetensors")
    assert actors.digest() == alone.actors().digest()
    assert processes.wait("rollout-0") == 0
    assert processes.wait("elite") == 0


def test_one_process_repeats_itself() -> None:
    """Equal seeds give equal weights, another seed gives others."""
    config = configured(TINY.replace("episodes = 8", "episodes = 2"))
    first, second = (train_in_process(config).actors().digest() for _ in range(2))
    other = train_in_process(from_toml("seed = 1", config)).actors().digest()
    assert first == second != other
    assert len(bytes.fromhex(first)) == hashlib.sha256().digest_size


def test_the_tiny_run_is_the_configured_one(tmp_path: Path) -> None:
    """The tests' configuration is read without change by those who get it over the wire."""
    config = configured()
    assert config.episodes == 8
    assert config.farm.world.uavs == 5
