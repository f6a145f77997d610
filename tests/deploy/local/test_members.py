"""The members of a population on this machine: configurations, folders, and what a population cannot have."""

import re
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import ClassVar

import pytest
from rich.console import Console

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import differences, from_toml, with_values
from eia_sec.common.errors import ConfigError, DivergenceError, EiaSecError, RunDirError, UsageError
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import POLICY, save_policy
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
SMALL = {"farm.world.steps": 40, "farm.world.sensors": 30}
"""A farm whose episodes take little time."""


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


class Trained:
    """A training in which some members finish and the others fail, without processes."""

    finish: ClassVar[tuple[str, ...]] = ()
    errors: ClassVar[dict[str, EiaSecError]] = {}

    def __init__(self, members: Members, console: Console) -> None:
        self._members = members

    def run(self) -> None:
        """Let them end."""
        for member in self._members.training:
            member.failure = self.errors.get(member.name)
            config, folder = member.plan.config, member.plan.directory.path
            if member.name in self.finish:
                actors = TeamActors.initial(farm_team(config.farm), 8, config.seed)
                save_policy(folder / POLICY, actors, {})
                (folder / "metrics.jsonl").write_text('{"kind": "end", "state": "finished"}\n')


def trained(root: Path, monkeypatch: pytest.MonkeyPatch, finish: Sequence[str], *errors: EiaSecError) -> str:
    """Train three members without a report; the first ones fail for these reasons. Return what is printed."""
    monkeypatch.setattr(train, "PopulationTraining", Trained)
    monkeypatch.setattr(Trained, "finish", tuple(finish))
    monkeypatch.setattr(Trained, "errors", {f"member-{number}": error for number, error in enumerate(errors)})
    config = with_values(CONFIG, {**SMALL, "population.farms": 1})
    directory, console = RunDirectory(root), Console(file=StringIO(), width=200)
    directory.prepare(config, resume=False)
    plan = ProcessPlan(config, 1, directory, Endpoint.parse("tcp/127.0.0.1:7447"))
    try:
        train._train_population(
            plan, TrainArguments(report=False, settings=config), farm_team(config.farm), console, []
        )
    finally:
        said = console.file.getvalue()
        (root / "said.txt").write_text(said)
    return said


def test_those_that_finished_are_ranked_although_another_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The best of them gives the run's policy; only then the failure is raised, as one that is not a user's mistake."""
    with pytest.raises(EiaSecError, match=r"^member-0 failed: it has diverged$") as failed:
        trained(tmp_path / "run", monkeypatch, ("member-1", "member-2"), DivergenceError("it has diverged"))
    assert not isinstance(failed.value, UsageError)
    said = (tmp_path / "run" / "said.txt").read_text()
    (best,) = re.findall(r"the best is (member-\d)", said)
    assert best in ("member-1", "member-2")
    assert "member-0" not in said
    assert "0 of 9" in said
    policy = (tmp_path / "run" / POLICY).read_bytes()
    assert policy == (tmp_path / "run" / "members" / best / POLICY).read_bytes()


def test_a_population_of_which_nobody_finished_has_no_best(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """All for the same mistake: exit code 2, said once; for a fault of one of them: 1, and each is named."""
    mistake = DivergenceError("it has diverged")
    with pytest.raises(UsageError, match=r"^all members failed: it has diverged$"):
        trained(tmp_path / "a", monkeypatch, (), mistake, mistake, mistake)
    fault = EiaSecError("no memory")
    with pytest.raises(EiaSecError, match=r"^member-0 failed: it has diverged; member-1 failed: no memory; ") as failed:
        trained(tmp_path / "b", monkeypatch, (), mistake, fault, fault)
    assert not isinstance(failed.value, UsageError)
    assert "the best is" not in (tmp_path / "b" / "said.txt").read_text()


def test_a_stopped_population_is_resumed_and_not_ranked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """While a member has neither finished nor failed."""
    said = trained(tmp_path / "run", monkeypatch, ("member-1",))
    assert said.startswith("stopped; resume with: eia-sec train")
    assert not (tmp_path / "run" / POLICY).exists()


def test_the_shared_seed_is_that_of_the_run():
    """Another one would be overwritten."""
    with pytest.raises(ConfigError, match=r"population\.seed is the run's own seed"):
        train.command(["--population", "2", "--seed", "3", "--population.seed", "7"])


def test_a_population_that_is_finished_has_no_coordinator(tmp_path: Path):
    """It would wait for members that never come."""
    team, root = farm_team(CONFIG.farm), RunDirectory(tmp_path / "run")
    root.prepare(CONFIG, resume=False)
    for directory in member_directories(root.path, CONFIG):
        directory.path.mkdir(parents=True)
        directory.prepare(member_config(CONFIG, int(directory.path.name[-1])), resume=False)
        (directory.path / "metrics.jsonl").write_text('{"kind": "end", "state": "finished"}\n')
    members = Members(root, ProcessPlan(CONFIG, 1, root, Endpoint.parse("tcp/127.0.0.1:7447"), resume=True), team)
    try:
        members.start()
        assert (members.over, members.supervisor.children) == (True, {})
    finally:
        members.stop()


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


def test_a_member_does_not_run_in_lockstep():
    """One that somebody starts without `eia-sec train` is refused as well."""
    with pytest.raises(ConfigError, match="a member of a population does not run in lockstep"):
        require_learners(CONFIG, 1, lockstep=True)


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
