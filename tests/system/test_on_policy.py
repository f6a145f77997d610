"""Runs of real processes that learn on policy: bit-equal to one process in lockstep, and complete without."""

import pytest

from eia_sec.common.config.files import from_toml, to_toml
from eia_sec.common.policy_file import load_policy, save_policy
from eia_sec.deploy.local.in_process import train_in_process
from tests.system.fleet import configured, on_policy, until


@pytest.mark.parametrize(
    ("name", "events", "memory"),
    [("ippo", 0, "none"), ("eia-ppo", 2, "none"), ("mappo", 0, "gru"), ("eia-ppo", 2, "gru")],
)
def test_lockstep_is_bit_equal_to_one_process(processes, name, events, memory):
    """After eight episodes, with two imitation events where elites are imitated, all actors are bit-equal."""
    text = on_policy(name, memory=memory)
    processes.config.write_text(text, encoding="utf-8")
    if events:
        processes.coordinator()
    processes.worker()
    processes.learner("--lockstep")
    assert processes.wait("learner") == 0
    alone = train_in_process(configured(text))
    assert (alone.events, alone.updates) == (events, 2 * 4 * (alone.environment_steps // 40))
    (end,) = processes.records("end")
    assert (end["state"], end["digest"]) == ("finished", alone.actors().digest())
    actors, _ = load_policy(processes.directory / "run" / "policy.safetensors")
    assert (actors.memory, actors.digest()) == (memory, alone.actors().digest())
    assert processes.wait("rollout-0") == 0


def test_a_run_begins_as_its_start_policy(processes):
    """Processes and one process begin as the file's actors and end bit-equal, elsewhere than from fresh actors."""
    text = on_policy("ippo")
    first = train_in_process(configured(text)).actors()
    file = processes.directory / "first.safetensors"
    save_policy(file, first, {})
    text = text.replace('name = "ippo"', f'name = "ippo"\nstart_policy = {{all = "{file}"}}')
    still = train_in_process(from_toml("[algorithm]\nvalue_steps = 1000000", configured(text)))
    assert still.actors().digest() == first.digest()
    processes.config.write_text(text, encoding="utf-8")
    processes.worker()
    processes.learner("--lockstep")
    assert processes.wait("learner") == 0
    (end,) = processes.records("end")
    assert end["digest"] == train_in_process(configured(text)).actors().digest() != first.digest()
    assert f"begins as {file}: communication, monitoring, collection." in processes.log("learner")


def test_a_resumed_run_begins_only_once(processes):
    """With a checkpoint it needs the policy's file no more; without any it begins with the file."""
    text = on_policy("ippo").replace("episodes = 8\n", "episodes = 1000000\n")
    first = train_in_process(configured(on_policy("ippo"))).actors()
    file = processes.directory / "first.safetensors"
    save_policy(file, first, {})
    still = f'name = "ippo"\nstart_policy = {{all = "{file}"}}\nvalue_steps = 1000000000'
    text = text.replace('name = "ippo"', still)
    processes.config.write_text(text, encoding="utf-8")
    (processes.directory / "run").mkdir()
    (processes.directory / "run" / "config.toml").write_text(to_toml(configured(text)), encoding="utf-8")
    processes.worker()
    for resumed in range(2):
        processes.learner("--resume")
        done = sum(record["updates"] for record in processes.records("status")[-1:])
        until(
            lambda done=done: processes.records("status")[-1:] and processes.records("status")[-1]["updates"] > done,
            "updates",
        )
        assert processes.drain()
        assert processes.wait("learner") == 0
        actors, _ = load_policy(processes.directory / "run" / "policy.safetensors")
        assert actors.digest() == first.digest()
        if not resumed:
            file.unlink()
    assert processes.log("learner").count("begins as") == 1


def test_one_process_repeats_itself():
    """Equal seeds give equal weights, another seed gives others."""
    config = configured(on_policy("ippo").replace("episodes = 8", "episodes = 4"))
    first, second = (train_in_process(config).actors().digest() for _ in range(2))
    other = train_in_process(from_toml("seed = 1", config)).actors().digest()
    assert first == second != other


@pytest.mark.parametrize("lag", [0, 1])
def test_free_running_workers_finish_a_run(processes, lag):
    """Without lockstep a run ends with all its episodes; what was too old was refused and is accounted for."""
    processes.config.write_text(on_policy("ippo", lag).replace("episodes = 8", "episodes = 24"), encoding="utf-8")
    processes.learner()
    processes.worker()
    assert processes.wait("learner") == 0
    (end,) = processes.records("end")
    status = processes.records("status")[-1]
    ledger, statistics = status["ledger"], status["statistics"]
    assert end["state"] == "finished"
    assert status["episodes"] >= 24
    assert ledger["unexplained"] == ledger["lost"] == 0
    assert ledger["accepted"] == status["environment_steps"]
    assert ledger["rejected"] == 20 * ledger["aged"]
    assert statistics["iterations"] == status["updates"] / 8 >= 20
    assert 0.0 <= statistics["sample_age_versions"] <= lag
