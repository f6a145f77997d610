import json

import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.files import from_toml, to_toml, with_setting
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import ConfigError, PolicyError, RunDirError, UsageError
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import save_policy
from eia_sec.deploy.commands.policies.evaluate import EvaluateArguments, command, evaluations, parse_farms
from eia_sec.deploy.policies.replay import Comparison, scenes_of

SMALL = (
    "farm.world.steps=20",
    "farm.world.sensors=30",
    "farm.world.monitoring_uavs=1",
    "farm.world.collection_uavs=1",
    "farm.world.communication_uavs=1",
)


def run(arguments):
    """Return the evaluation of a policy's likeliest actions."""
    return evaluations(arguments)[0]


@pytest.fixture
def run_dir(tmp_path):
    config = PRESETS["inertial"]
    for line in SMALL:
        config = from_toml(line, config)
    folder = tmp_path / "my-run"
    folder.mkdir()
    (folder / "config.toml").write_text(to_toml(config))
    save_policy(folder / "policy.safetensors", TeamActors.initial(farm_team(config.farm), 8, 0), {})
    return folder


def test_json_is_printed_and_nothing_else(capsys):
    """With --json standard output is one JSON document for the farms that were asked for."""
    assert command(["--policy", "random", "--farms", "5:7", "--json", "--set", *SMALL]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["policy"] == "random"
    assert printed["farms"] == [5, 6]


def test_values_of_several_sets_all_count(capsys):
    """Whether they stand behind one `--set` or behind one each, before or after other options."""
    first, *rest = SMALL
    printed = []
    for words in (
        ["--set", *SMALL, "--farms", "5:6"],
        [f"--set={first}", "--farms", "5:6", *(word for value in rest for word in ("--set", value))],
    ):
        assert command(["--policy", "random", "--json", *words]) == 0
        printed.append(json.loads(capsys.readouterr().out))
    assert printed[0] == printed[1]
    with pytest.raises(ConfigError, match="nonsense"):
        command(["--policy", "random", "--farms", "5:6", "--set", "farm.nonsense=1", "--set", first])


def test_a_table_is_printed_for_people(capsys):
    """Without --json a table names the policy."""
    assert command(["--policy", "static", "--farms", "5:6", "--set", *SMALL]) == 0
    assert "static" in capsys.readouterr().out


def test_a_run_directory_gives_its_policy_and_its_farm(run_dir):
    """The run's actors fly the run's farm, under the directory's name."""
    evaluation = run(EvaluateArguments(run_dir=run_dir, farms="5:6", episodes=2))
    assert evaluation.policy == "my-run"
    assert evaluation.episodes == 2
    same = run(EvaluateArguments(policy=str(run_dir / "policy.safetensors"), farms="5:6", episodes=2, set=SMALL))
    assert same.per_farm == evaluation.per_farm


def test_a_heuristic_flies_the_farm_of_a_run(run_dir):
    """With both given, the named policy flies the run's farm."""
    evaluation = run(EvaluateArguments(run_dir=run_dir, policy="greedy", farms="5:6"))
    assert evaluation == run(EvaluateArguments(policy="greedy", farms="5:6", set=SMALL))


def test_file_and_single_values_change_the_farm(run_dir, tmp_path):
    """A configuration file replaces the run's values, and single values replace the file's."""
    (tmp_path / "more.toml").write_text("[farm.world]\nsteps = 30\nvdf_cycle = 10\n")
    plain = run(EvaluateArguments(run_dir=run_dir, farms="5:6"))
    longer = run(EvaluateArguments(run_dir=run_dir, farms="5:6", config=tmp_path / "more.toml"))
    again = run(
        EvaluateArguments(
            run_dir=run_dir,
            farms="5:6",
            config=tmp_path / "more.toml",
            set=("farm.world.steps=20", "farm.world.vdf_cycle=30"),
        )
    )
    assert longer.total.metrics["energy_j"] > plain.total.metrics["energy_j"]
    assert again == plain


@pytest.mark.parametrize("text", ["", "1000", "5:5", "7:5", "a:b", "-3:4", "1:2:3", "1.5:3", "0:100001"])
def test_farms_that_cannot_be_are_refused(text):
    """Whatever is not A:B with A below B gives one sentence."""
    with pytest.raises(UsageError, match="--farms"):
        parse_farms(text)


def test_farms_are_a_half_open_range():
    """A:B names the farms A to B - 1."""
    assert list(parse_farms("1000:1003")) == [1000, 1001, 1002]


def test_mistakes_are_usage_errors(run_dir, tmp_path):
    """What is missing, unknown or does not fit is said in a typed error."""
    with pytest.raises(PolicyError, match="nothing to evaluate"):
        run(EvaluateArguments())
    with pytest.raises(UsageError, match="--episodes"):
        run(EvaluateArguments(policy="random", episodes=0))
    with pytest.raises(RunDirError, match="there is no directory"):
        run(EvaluateArguments(run_dir=tmp_path / "nowhere"))
    with pytest.raises(ConfigError, match="unknown configuration key"):
        run(EvaluateArguments(policy="random", set=("farm.world.colour=3",)))
    with pytest.raises(PolicyError, match="this environment has"):
        run(EvaluateArguments(run_dir=run_dir, set=("farm.world.monitoring_uavs=2",)))
    (run_dir / "policy.safetensors").unlink()
    with pytest.raises(RunDirError, match="not saved a policy yet"):
        run(EvaluateArguments(run_dir=run_dir))


CHOICES = ("farm.control.communication=headings", "farm.control.monitoring=moves", "farm.control.collection=moves")


@pytest.mark.parametrize("shared", [False, True])
def test_actors_that_choose_are_evaluated_and_replayed(tmp_path, shared):
    """A run whose UAVs choose moves and headings is flown by its file, and by no file of another control."""
    config = PRESETS["instant"]
    for line in (*SMALL, *CHOICES):
        config = with_setting(config, line)
    (tmp_path / "config.toml").write_text(to_toml(config))
    actors = TeamActors.initial(farm_team(config.farm), 8, 0, shared=shared)
    save_policy(tmp_path / "policy.safetensors", actors, {})
    found = run(EvaluateArguments(run_dir=tmp_path, farms="5:6"))
    assert found.total.steps == 20.0
    path = str(tmp_path / "policy.safetensors")
    scenes = [scene for scene, _ in scenes_of(Comparison(config.farm, (path, "static"), ("a", "b"), 5, 0))]
    assert scenes[-1].reward["mean"] == pytest.approx(found.total.reward)
    with pytest.raises(PolicyError, match=r"9 options, nine moves, lattice.*this environment has"):
        run(EvaluateArguments(run_dir=tmp_path, farms="5:6", set=("farm.control.monitoring=lattice",)))
