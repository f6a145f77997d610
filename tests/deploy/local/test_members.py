"""The members of a population on this machine: configurations, folders, and what a population cannot have."""

from pathlib import Path

import pytest

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import differences, from_toml
from eia_sec.common.errors import ConfigError, RunDirError, UsageError
from eia_sec.common.farm import farm_team
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.commands.training import train
from eia_sec.deploy.commands.training.train import TrainArguments
from eia_sec.deploy.local.learners import require_learners
from eia_sec.deploy.local.members import Members, member_config, member_directories
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.local.training_processes import ProcessPlan
from eia_sec.deploy.options import base_configuration, parse

TABLE = "seed = 3\n[population]\nmembers = 3\n[population.hyperparameters]\nactor_rate = [1e-4, 1e-2]\n"
CONFIG = from_toml(TABLE, RunConfig())


def test_members_differ_in_seed_and_hyperparameters_alone():
    """Member 0 is the run; what all share is the same for all, and everybody's values lie in the ranges."""
    configs = [member_config(CONFIG, number) for number in range(3)]
    assert differences(CONFIG, configs[0]) == ["population.seed: 0 -> 3"]
    for config in configs[1:]:
        keys = {line.partition(":")[0] for line in differences(configs[0], config)}
        assert keys == {"seed", "algorithm.actor_rate"}
        assert 1e-4 <= config.algorithm.actor_rate <= 1e-2
    assert len({config.seed for config in configs}) == len({config.algorithm.actor_rate for config in configs}) == 3
    assert member_config(CONFIG, 2) == configs[2]


def test_each_member_has_a_folder_and_ports_of_its_own(tmp_path: Path):
    """A second start there is refused, unless it resumes; then only those train that have not finished."""
    team, root = farm_team(CONFIG.farm), RunDirectory(tmp_path / "run")
    root.prepare(CONFIG, resume=False)
    plan = ProcessPlan(CONFIG, 1, root, Endpoint.parse("tcp/127.0.0.1:7447"))
    members = Members(root, plan, team).training
    folders = [directory.path for directory in member_directories(root.path, CONFIG)]
    assert [member.plan.directory.path for member in members] == folders
    assert [member.plan.run for member in members] == ["member-0", "member-1", "member-2"]
    assert len({member.plan.endpoint.port for member in members}) == 3
    assert not any(member.plan.coordinated for member in members)
    for member, folder in zip(members, folders, strict=True):
        assert member.plan.config == RunDirectory(folder).configuration()
        member.plan.directory.unlock()
        (folder / "metrics.jsonl").write_text('{"kind": "end", "state": "draining"}\n')
    (folders[1] / "metrics.jsonl").write_text('{"kind": "end", "state": "finished"}\n')
    with pytest.raises(RunDirError, match=r"member-0 already holds a run; add --resume"):
        Members(root, plan, team)
    resumed = Members(root, ProcessPlan(CONFIG, 1, root, plan.endpoint, resume=True), team).training
    assert [member.name for member in resumed] == ["member-0", "member-2"]


@pytest.mark.parametrize(
    "words",
    [
        ["--lockstep"],
        ["--learners", "2"],
        ["--demonstrations", "file"],
        ["--track", "mlflow"],
        ["--endpoint", "tcp/127.0.0.1:7447"],
    ],
)
def test_what_is_for_a_run_alone_is_refused(words):
    """Before any process starts, by the option's name."""
    with pytest.raises(UsageError, match=f"^{words[0]} is for a run alone; leave it or --population out"):
        train.command(["--population", "2", *words])


def test_environments_that_others_serve_are_refused():
    """Two members would claim the same robots."""
    with pytest.raises(ConfigError, match="a population cannot share zenoh:site"):
        train.command(["--population", "2", "--env", "zenoh:site"])


def test_a_member_has_one_learner():
    """Hyperparameters change in one process."""
    with pytest.raises(ConfigError, match="a member of a population has one learner"):
        require_learners(CONFIG, 2, lockstep=False)


def test_a_command_line_names_ranges():
    """LOW:HIGH each, and an option of a population needs one."""

    def parsed(*words: str) -> RunConfig:
        return parse(TrainArguments, words, "train", TrainArguments(settings=base_configuration(words))).settings

    words = ("--population", "2", "--population.hyperparameters", "actor_rate=1e-4:1e-2", "entropy_start=0.001:0.1")
    found = parsed(*words).population
    assert (found.members, dict(found.hyperparameters)) == (
        2,
        {"actor_rate": (1e-4, 1e-2), "entropy_start": (0.001, 0.1)},
    )
    for value in ("actor_rate=1", "actor_rate=a:b", "actor_rate"):
        with pytest.raises(UsageError, match="hyperparameters"):
            parsed("--population", "2", "--population.hyperparameters", value)
    with pytest.raises(ConfigError, match=r"has no effect while population\.members is 0"):
        parsed("--population.rate", "0.5")
