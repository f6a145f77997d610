"""A run begins as another policy where that sees and chooses the same."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.files import to_toml, with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import PolicyError
from eia_sec.common.farm import farm_environment, farm_team
from eia_sec.common.policy_file import load_policy, save_policy
from eia_sec.rollout.shipped_policies import shipped_file
from eia_sec.rollout.start_policy import start_parameters, start_sentence

NAMES = ("communication", "monitoring", "collection")

TRAINED = shipped_file("trained:instant")


def begun(values, name="instant"):
    """Return the configuration with these values, and what its types begin with."""
    config = with_values(preset(name), values)
    return config, start_parameters(config, farm_team(config.farm))


def shared(team):
    """Return random actors that the agents of each type share."""
    own = TeamActors.initial(team, 64, 3)
    return replace(own, flat=tuple(flat[:1] for flat in own.flat))


def test_without_a_policy_all_types_begin_fresh():
    """Nothing is to be replaced, on policy and off."""
    assert begun({})[1] == begun({}, "eia-sec")[1] == ()


def test_all_types_begin_as_the_policy_of_their_own_farm():
    """Bit for bit, from a name and from a file."""
    actors, _ = load_policy(TRAINED)
    for source in ("trained:instant", str(TRAINED)):
        _, found = begun({"algorithm.start_policy.all": source})
        for flat, own in zip(found, actors.flat, strict=True):
            np.testing.assert_array_equal(flat, own)


def test_types_that_see_something_else_begin_fresh():
    """UAVs that see plans have more inputs than the preset instant's; its relays have not."""
    for config, found in (
        begun({"algorithm.start_policy.all": "trained:instant", "farm.observation.plan": 3}),
        begun({}, "uneven"),
    ):
        fresh = [flat is None for flat in found]
        assert dict(zip(NAMES, fresh, strict=True)) == {"communication": False, "monitoring": True, "collection": True}
        said = start_sentence(config, farm_team(config.farm), found)
        assert said == "begins as trained:instant: communication; fresh actors: monitoring, collection"


def test_a_named_type_may_see_more_than_the_policy():
    """It acts as the policy does, whatever the new inputs are; types that are not named begin fresh."""
    values = {
        "farm.observation.plan": 3,
        "algorithm.start_policy": {"monitoring": "trained:instant", "communication": "trained:instant"},
    }
    config, found = begun(values)
    for flat, own in zip(begun({}, "long")[1], found, strict=True):
        np.testing.assert_array_equal(flat, own)
    assert [flat is None for flat in found] == [False, False, True]
    plain, team = farm_environment(preset("instant").farm), farm_team(config.farm)
    names = [spec.tensor_names["monitoring"].observation for spec in (plain, farm_environment(config.farm))]
    place = [names[1].index(name) for name in names[0]]
    actors = load_policy(TRAINED)[0]
    wider = replace(shared(team), flat=(found[0], found[1], shared(team).flat[2]), head=actors.head)
    draw = np.random.default_rng(5)
    rows = [draw.uniform(-1, 1, (4, group.observation_size)).astype(np.float32) for group in team.groups]
    few = [rows[0], rows[1][:, place], rows[2][:, : plain.team.groups[2].observation_size]]
    flat = [np.concatenate([part.reshape(-1) for part in parts])[None] for parts in (few, rows)]
    outputs = [own.act(row)[:, 4:8] for own, row in zip((actors, wider), flat, strict=True)]
    np.testing.assert_array_equal(outputs[0], outputs[1])
    said = start_sentence(config, team, found)
    assert said == "begins as trained:instant: communication, monitoring; fresh actors: collection"


def test_types_can_begin_as_different_policies(tmp_path):
    """Each as the one that is named for it; a type that is given none begins fresh."""
    file = tmp_path / "policy.safetensors"
    own = shared(farm_team(preset("instant").farm))
    save_policy(file, own, {})
    config, found = begun(
        {"algorithm.start_policy": {"monitoring": str(file), "communication": "trained:instant", "collection": ""}}
    )
    np.testing.assert_array_equal(found[1], own.flat[1])
    np.testing.assert_array_equal(found[0], load_policy(TRAINED)[0].flat[0])
    said = start_sentence(config, farm_team(config.farm), found)
    assert said == f"begins as trained:instant: communication; begins as {file}: monitoring; fresh actors: collection"
    assert all(flat is not None for flat in begun({"algorithm.start_policy.all": str(file)})[1])


def test_as_many_inputs_are_not_enough(tmp_path):
    """What a policy observes is compared where it is known: of one that ships, and beside a run's configuration."""
    other = {"farm.observation.lattice": False, "farm.observation.last_move": True}
    same_size = {"farm.observation.lattice": True, "farm.observation.last_move": False}
    fresh = [flat is None for flat in begun({"algorithm.start_policy.all": "trained:instant", **other})[1]]
    assert fresh == [False, True, False]
    file = tmp_path / "policy.safetensors"
    trained = with_values(preset("instant"), same_size)
    save_policy(file, TeamActors.initial(farm_team(trained.farm), 64, 3), {})
    wanted = {"algorithm.start_policy.all": str(file), "algorithm.shared_until": 0.0, **other}
    sizes = [farm_team(with_values(preset("instant"), of).farm).groups[1].observation_size for of in (other, same_size)]
    assert sizes[0] == sizes[1]
    assert begun(wanted)[1][1] is not None
    (tmp_path / "config.toml").write_text(to_toml(trained))
    with pytest.raises(PolicyError, match="fits no type"):
        begun(wanted)


@pytest.mark.parametrize("name", ["n" * 5000, "nobody/nowhere.safetensors"])
def test_odd_names_are_refused_in_one_sentence(name):
    """So is a name that no file system takes."""
    with pytest.raises(PolicyError, match="is neither a policy that ships nor a readable file"):
        begun({"algorithm.start_policy.all": name})


def test_an_actor_that_a_type_shares_becomes_one_of_each_agent():
    """Equal rows for all agents, and of their own memory."""
    actors, _ = load_policy(TRAINED)
    config, found = begun({"algorithm.start_policy.all": "trained:instant", "algorithm.shared_until": 0.0})
    for flat, own, group in zip(found, actors.flat, farm_team(config.farm).groups, strict=True):
        np.testing.assert_array_equal(flat, np.repeat(own, group.count, axis=0))
        assert flat.flags.writeable


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"algorithm.start_policy.all": "nobody"}, "'nobody' is neither a policy that ships nor a readable file"),
        ({"algorithm.start_policy.all": "trained:instant", "algorithm.hidden": 32}, "fits no type of this run"),
        ({"algorithm.start_policy.all": "trained:instant", "algorithm.memory": "gru"}, "fits no type of this run"),
        ({"algorithm.start_policy.all": "trained:eia-sec"}, "fits no type of this run"),
        (
            {"algorithm.start_policy": {"communication": "trained:instant", "all": "trained:instant"}},
            "names 'all', but .* stands alone",
        ),
        (
            {"algorithm.start_policy.drones": "trained:instant"},
            "names 'drones', but the types are communication, monitoring",
        ),
        (
            {"algorithm.start_policy": {"communication": "trained:instant", "monitoring": "trained:eia-sec"}},
            "monitoring agents of this run do not fit 'trained:eia-sec'",
        ),
        (
            {"algorithm.start_policy.monitoring": "trained:long"},
            "monitoring agents of this run do not fit 'trained:long'",
        ),
    ],
)
def test_a_policy_that_cannot_be_begun_with_is_refused(values, said):
    """One sentence says why."""
    with pytest.raises(PolicyError, match=said):
        begun(values)


def test_agents_with_actors_of_their_own_do_not_become_one(tmp_path):
    """Nobody could say which of them a shared actor should begin as."""
    team = farm_team(preset("instant").farm)
    save_policy(tmp_path / "own.safetensors", TeamActors.initial(team, 64, 3, per_type=False), {})
    values = {"algorithm.start_policy.all": str(tmp_path / "own.safetensors")}
    with pytest.raises(PolicyError, match="fits no type"):
        begun(values)
    config, found = begun({**values, "algorithm.shared_until": 0.0})
    assert [len(flat) for flat in found if flat is not None] == [group.count for group in farm_team(config.farm).groups]
