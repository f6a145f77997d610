"""A population in a fleet file: whose learner and workers run where, what is refused, and what belongs to whom."""

from pathlib import Path

import pytest

from eia_sec.common.config.files import read_saved
from eia_sec.common.errors import ConfigError
from eia_sec.common.transport.credentials import Identity
from eia_sec.deploy.hosts import operations
from eia_sec.deploy.hosts.fleet_file import FleetSpec, read
from eia_sec.deploy.hosts.history_collection import own_names
from eia_sec.deploy.hosts.plan import here, processes
from eia_sec.deploy.hosts.render import keeping, render
from eia_sec.deploy.local.members import member_config

FLEET = """run = "test"
[training]
preset = "quick"
set = ["population.members = 4", "population.hyperparameters.actor_rate = [1e-4, 1e-2]"]
[network]
endpoint = "tls/one:7447"
keys = "keys"
[router]
host = "one"
[population.member-0]
host = "one"
[population.member-2]
host = "two"
[population.member-1]
host = "two"
[hosts.one]
workers = 1
[hosts.two]
workers = 3
[hosts.three]
workers = 2
member = "member-0"
"""


@pytest.fixture
def fleet(tmp_path: Path) -> FleetSpec:
    """Three members on two hosts; the third host's workers serve the first member."""
    return written(tmp_path)


def written(folder: Path, old: str = "", new: str = "") -> FleetSpec:
    """Return the fleet after a change of its file."""
    assert old in FLEET
    (folder / "fleet.toml").write_text(FLEET.replace(old, new, 1) if old else FLEET)
    return read(folder / "fleet.toml")


def test_each_member_has_a_learner_and_workers(fleet):
    """A host's workers serve the members that learn there, in turn, or whom the file says; one coordinator all."""
    found = {process.label: process for process in processes(fleet, here(fleet))}
    runs = {name: process.run.name for name, process in found.items() if process.run is not None}
    assert runs == {
        "learner.member-0": "test-member-0",
        "learner.member-2": "test-member-2",
        "learner.member-1": "test-member-1",
        "rollout.one-0": "test-member-0",
        "rollout.two-0": "test-member-2",
        "rollout.two-1": "test-member-1",
        "rollout.two-2": "test-member-2",
        "rollout.three-0": "test-member-0",
        "rollout.three-1": "test-member-0",
    }
    for name, run in runs.items():
        words = found[name].arguments
        assert words[words.index("--run") + 1] == run
    elite = found["elite.coordinator"]
    begin = elite.arguments.index("--members") + 1
    assert elite.arguments[begin : begin + 3] == tuple(f"test-member-{k}=tls/one:7447" for k in (0, 2, 1))
    assert (elite.host, found["learner.member-2"].identity) == ("one", Identity("learner", "learner"))
    words = found["rollout.two-1"].arguments
    assert words[words.index("--history") + 1] == "run/members/member-1/history/rollout-two-1.jsonl"


def test_members_have_the_configurations_of_train(fleet):
    """Seeds and hyperparameters are those that `eia-sec train` gives members of these numbers."""
    operations.issue_keys(fleet, 1)
    for run, number in zip(fleet.runs, (0, 2, 1), strict=True):
        assert run.config == member_config(fleet.config, number)
        files = operations.request_of(fleet, run.learner.host)["files"]
        assert read_saved(files[f"config-member-{number}.toml"]) == run.config
        assert any(name.startswith("keys/learner.learner/") for name in files)


def test_processes_of_finished_members_are_not_started(fleet):
    """Router and coordinator run while any member is left."""
    every = {process.label for process in processes(fleet, here(fleet))}
    assert set(operations.starting(fleet, ())) == every
    ended = {"learner.member-0", "rollout.one-0", "rollout.three-0", "rollout.three-1"}
    assert set(operations.starting(fleet, {"learner.member-0"})) == every - ended
    assert operations.starting(fleet, {f"learner.member-{k}" for k in range(3)}) == []


def test_a_host_sends_what_belongs_to_its_members(fleet):
    """Learners' files of the members that learn there, and its own workers' histories of any member."""
    own = own_names(fleet, "two")
    assert own("members/member-1/metrics.jsonl")
    assert own("members/member-2/history/learner.jsonl")
    assert own("members/member-0/history/rollout-two-1.jsonl")
    for other in ("members/member-0/metrics.jsonl", "metrics.jsonl", "members/member-3/history/rollout-two-0.jsonl"):
        assert not own(other)
    assert not own("members/member-1/history/rollout-one-0.jsonl")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('[router]\nhost = "one"\n', "", r"meet at a router; add \[router\]"),
        ("[population.member-2]", '[learner]\nhost = "one"\n[population.member-2]', r"remove \[learner\]"),
        ("[population.member-2]", "[population.second]", "population.second must be named member-N"),
        ("[population.member-2]", "[population.member-64]", "population.member-64 must be named member-N"),
        ("[population.member-2]", "[population.member-7]", "population.member-7 needs population.members of 8 or more"),
        ('member = "member-0"\n', "", "hosts.three has workers and no learner of the population"),
        ('member = "member-0"\n', 'member = "member-3"\n', r"\(member-0, member-2, member-1\), not 'member-3'"),
        ('host = "two"\n', 'host = "four"\n', "population.member-2.host must be one of the hosts one, two, three"),
        ('host = "two"\n', 'host = "two"\nlearners = 2\n', "a member of a population has one learner"),
        ('host = "two"\n', 'host = "two"\ngpus = -1\n', "population.member-2.gpus must be 0 to 64"),
        (
            '"population.members = 4"',
            '"population.members = 4", "population.seed = 5"',
            "population.seed is the run's own",
        ),
        ('"population.members = 4", ', "", "population"),
    ],
)
def test_mistakes_name_the_place(tmp_path, old, new, said):
    """Before anything starts."""
    with pytest.raises(ConfigError, match=said):
        written(tmp_path, old, new)


def test_it_is_not_rendered(fleet, tmp_path):
    """In any form; one sentence says what starts it."""
    for form in ("systemd", "compose", "kubernetes", "prometheus"):
        for write in (render, keeping):
            with pytest.raises(ConfigError, match=r"describes a population, which .* cannot write; use `eia-sec up`"):
                write(fleet, form, tmp_path / "rendered")
    assert not (tmp_path / "rendered").exists()
