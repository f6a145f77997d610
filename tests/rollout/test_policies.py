from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import FarmConfig, ObservationConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import PolicyError
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import save_policy
from eia_sec.deploy.commands.policies.evaluate import POLICY_HELP
from eia_sec.rollout import shipped_policies
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.heuristics.registry import HEURISTICS, RELAYS, TASKS, default_relays
from eia_sec.rollout.policies import POLICIES, ActorPolicy, policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from tests.rollout.heuristics.small_farm import SMALL

ROOT = Path(__file__).resolve().parents[2]


def begin(config, policy, environments=3):
    farms = FarmBatch(config, environments)
    for index in range(environments):
        farms.reset(index, 7 + index, index)
        policy.reset(farms, index)
    return farms


def test_static_moves_nobody():
    """The static policy leaves every UAV where it started."""
    policy = policy_of("static", SMALL)
    farms = begin(SMALL, policy)
    before = np.array(farms.position)
    for _ in range(5):
        farms.step(policy.act(farms))
    np.testing.assert_array_equal(farms.position, before)


def test_random_depends_on_the_episode_alone():
    """The same episode gets the same random actions at any place in any batch; another episode gets others."""
    alone, beside = policy_of("random", SMALL), policy_of("random", SMALL)
    one, two = FarmBatch(SMALL, 1), FarmBatch(SMALL, 2)
    one.reset(0, 5, 6)
    two.reset(1, 5, 6)
    two.reset(0, 5, 7)
    alone.reset(one, 0)
    beside.reset(two, 1)
    beside.reset(two, 0)
    for _ in range(3):
        rows = beside.act(two)
        np.testing.assert_array_equal(alone.act(one)[0], rows[1])
        assert not np.array_equal(rows[0], rows[1])


def test_actor_policy_equals_its_actors():
    """The actor policy's actions are those that the actors compute from the observation."""
    actors = TeamActors.initial(farm_team(SMALL), 16, 3, per_type=False)
    policy = ActorPolicy(actors)
    farms = begin(SMALL, policy)
    np.testing.assert_allclose(policy.act(farms), actors.environment_actions(farms.observation), atol=1e-6)


def test_actors_of_another_team_are_refused():
    """A policy for other observations or counts is a PolicyError that names both teams."""
    policy = ActorPolicy(TeamActors.initial(farm_team(FarmConfig()), 16, 3))
    farms = FarmBatch(SMALL, 1)
    farms.reset(0, 1, 1)
    with pytest.raises(PolicyError, match=r"4 monitoring agents .* this environment has .* 2 monitoring agents"):
        policy.reset(farms, 0)


def test_a_policy_file_is_a_policy(tmp_path):
    """A path in place of a name gives the file's actors."""
    actors = TeamActors.initial(farm_team(SMALL), 16, 3)
    save_policy(tmp_path / "mine.safetensors", actors, {})
    farms = begin(SMALL, ActorPolicy(actors))
    flown = policy_of(str(tmp_path / "mine.safetensors"), SMALL)
    np.testing.assert_array_equal(flown.act(farms), ActorPolicy(actors).act(farms))


def test_the_trained_policy_is_that_of_the_package(tmp_path, monkeypatch):
    """The name `trained` loads the shipped file, and says so when there is none or when the team differs."""
    file = tmp_path / "mine.safetensors"
    monkeypatch.setitem(shipped_policies.SHIPPED, "trained", ("inertial", file))
    with pytest.raises(PolicyError, match="no trained policy of the preset inertial is part of this installation"):
        policy_of("trained", SMALL)
    save_policy(file, TeamActors.initial(farm_team(SMALL), 16, 3), {})
    assert isinstance(policy_of("trained", SMALL), ActorPolicy)
    with pytest.raises(PolicyError, match="this environment has 4 communication agents"):
        policy_of("trained", FarmConfig())


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in shipped_policies.SHIPPED if name != "trained:eia-sec"])
def test_every_shipped_policy_flies_its_farm_better_than_greedy(name):
    """On farms of its preset, which training never saw; the policy of `eia-sec` has a test of its own."""
    farm = preset(shipped_policies.preset_of(name)).farm
    found = [
        evaluate(farm, policy_of(policy, farm), range(1500, 1502), 1, name=policy).total.reward
        for policy in (name, "greedy")
    ]
    assert found[0] > found[1]


def test_the_policy_of_eia_sec_ships_too():
    """It flies the farm of the preset `eia-sec`, and no farm with other observations."""
    assert isinstance(policy_of("trained:eia-sec", preset("eia-sec").farm), ActorPolicy)
    with pytest.raises(PolicyError, match="this environment has 4 communication agents"):
        policy_of("trained:eia-sec", FarmConfig())
    assert [shipped_policies.preset_of(name) for name in ("trained", "trained:eia-sec", "greedy", None)] == [
        "inertial",
        "eia-sec",
        "inertial",
        "inertial",
    ]


def test_an_unknown_policy_is_refused_with_the_known_names():
    """A name that is neither a policy nor a file gives one sentence with every name."""
    with pytest.raises(PolicyError) as refused:
        policy_of("nobody", SMALL)
    assert all(name in str(refused.value) for name in POLICIES)


def test_heuristics_have_one_list():
    """The registry, the files and the documentation name the same heuristics; the command's help takes its names."""
    files = {path.stem for path in (ROOT / "rollout/heuristics").rglob("*.py")}
    assert set(HEURISTICS) == {*TASKS, "static", "random"} <= files
    page = (ROOT / "docs/reference/heuristics.md").read_text()
    named = {line.split("`")[1] for line in page.splitlines() if line.startswith("| `")}
    assert named == {*HEURISTICS, *RELAYS}
    assert set(POLICIES) <= set(POLICY_HELP.replace(",", " ").replace(".", " ").split())


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("relays", RELAYS)
def test_a_task_and_its_relays_make_a_name(task, relays):
    """TASK+RELAYS is a policy; without relays those fly that the farm needs."""
    actions = {}
    for name in (task, f"{task}+{relays}"):
        policy = policy_of(name, SMALL)
        farms = begin(SMALL, policy, 1)
        farms.step(policy.act(farms))
        actions[name] = policy.act(farms)
    same = (actions[task] == actions[f"{task}+{relays}"]).all()
    # Relays that keep links up may stay for a while, as the default ones do.
    assert same == (relays == default_relays(SMALL)) or relays == "coverage"


@pytest.mark.parametrize("name", ["static+search", "greedy+nobody", "+search", "greedy+", "trained+centroid"])
def test_other_combinations_are_refused(name):
    """Only a task heuristic takes relays, and only those in the registry."""
    with pytest.raises(PolicyError, match="there is no policy"):
        policy_of(name, SMALL)


def test_a_policy_steers_by_the_lattice_of_the_farm_that_it_flies_over():
    """Actors of one field fly over a wider one by its own lattice; those that command velocities are another kind."""
    farm = preset("eia-sec").farm
    wide = replace(farm, world=replace(farm.world, field_x=500.0, field_y=300.0, plots_x=25, plots_y=15))
    policy = ActorPolicy(TeamActors.initial(farm_team(farm), 16, 3))
    farms = begin(wide, policy)
    lattice = farms.team.groups[1].adapters[0]
    assert (lattice.columns, lattice.rows) == (50, 30)
    action = np.concatenate(
        [TeamActors.initial(farms.team, 16, 3).environment_actions(row[None]) for row in farms.observation]
    )
    np.testing.assert_array_equal(policy.act(farms), action)
    printed = replace(farm, control=replace(farm.control, monitoring="velocity"))
    with pytest.raises(PolicyError, match=r"4 monitoring agents with 41 inputs \(2 outputs, lattice, mirrored axes\)"):
        begin(printed, policy)


def test_a_mirrored_policy_is_another_kind_even_where_sizes_are_the_same():
    """With one UAV of each type the two signs take as many numbers as rank and clock."""
    one = replace(FarmConfig().world, communication_uavs=1, monitoring_uavs=1, collection_uavs=1)
    plain = FarmConfig(world=one, observation=ObservationConfig(mirrored=False))
    mirrored = FarmConfig(world=one, observation=ObservationConfig(mirrored=True, identity=False, clock=False))
    teams = farm_team(plain), farm_team(mirrored)
    assert teams[0].observation_size == teams[1].observation_size
    policy = ActorPolicy(TeamActors.initial(teams[1], 16, 3))
    begin(mirrored, policy)
    with pytest.raises(PolicyError, match="mirrored axes"):
        begin(plain, policy)


@pytest.mark.parametrize("counts", [(1, 2, 3), (5, 6, 8)])
def test_shared_actors_fly_teams_of_other_sizes(counts):
    """Without ranks, one actor for all UAVs of a type flies any number of them; separate actors do not."""
    farm = preset("instant").farm
    uavs = dict(zip(("communication_uavs", "monitoring_uavs", "collection_uavs"), counts, strict=True))
    farm = replace(farm, observation=replace(farm.observation, identity=False))
    other = replace(farm, world=replace(farm.world, **uavs))
    shared = TeamActors.initial(farm_team(farm), 16, 3, head="categorical", shared=True)
    policy = ActorPolicy(shared)
    farms = begin(other, policy)
    expected = TeamActors(farms.team, 16, shared.flat, "categorical")
    for _ in range(3):
        action = policy.act(farms)
        np.testing.assert_array_equal(action, [expected.environment_actions(row[None])[0] for row in farms.observation])
        farms.step(action)
    assert action.shape == (3, 2 * sum(counts))
    with pytest.raises(PolicyError, match="4 monitoring agents"):
        begin(other, ActorPolicy(TeamActors.initial(farm_team(farm), 16, 3, head="categorical")))
