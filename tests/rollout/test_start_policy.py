"""A run begins as another policy where that sees and chooses the same."""

import numpy as np
import pytest

from common.actors import TeamActors
from common.config.files import to_toml, with_values
from common.config.presets import preset
from common.errors import PolicyError
from common.farm import farm_team
from common.policy_file import load_policy, save_policy
from rollout.policies import TRAINED
from rollout.start_policy import start_parameters, start_sentence

NAMES = ("communication", "monitoring", "collection")


def begun(values, name="default"):
    """Return the configuration with these values, and what its types begin with."""
    config = with_values(preset(name), values)
    return config, start_parameters(config, farm_team(config.farm))


def test_without_a_policy_all_types_begin_fresh():
    """Nothing is to be replaced, on policy and off."""
    assert begun({})[1] == begun({}, "eia-sec")[1] == ()


def test_all_types_begin_as_the_policy_of_their_own_farm():
    """Bit for bit, from a name and from a file."""
    actors, _ = load_policy(TRAINED)
    for source in ("trained", str(TRAINED)):
        _, found = begun({"algorithm.start_policy": source})
        for flat, own in zip(found, actors.flat, strict=True):
            np.testing.assert_array_equal(flat, own)


def test_types_that_see_something_else_begin_fresh():
    """UAVs that see plans have more inputs than the default preset's; its relays have not."""
    for config, found in (begun({"algorithm.start_policy": "trained", "farm.observation.plan": 3}), begun({}, "long")):
        fresh = [flat is None for flat in found]
        assert dict(zip(NAMES, fresh, strict=True)) == {"communication": False, "monitoring": True, "collection": True}
        said = start_sentence(config, farm_team(config.farm), found)
        assert said == "begins as trained: communication; fresh actors: monitoring, collection"


def test_as_many_inputs_are_not_enough(tmp_path):
    """What a policy observes is compared where it is known: of one that ships, and beside a run's configuration."""
    other = {"farm.observation.lattice": False, "farm.observation.last_move": True}
    same_size = {"farm.observation.lattice": True, "farm.observation.last_move": False}
    fresh = [flat is None for flat in begun({"algorithm.start_policy": "trained", **other})[1]]
    assert fresh == [False, True, False]
    file = tmp_path / "policy.safetensors"
    trained = with_values(preset("default"), same_size)
    save_policy(file, TeamActors.initial(farm_team(trained.farm), 64, 3), {})
    wanted = {"algorithm.start_policy": str(file), "algorithm.parameters": "separate", **other}
    sizes = [farm_team(with_values(preset("default"), of).farm).groups[1].observation_size for of in (other, same_size)]
    assert sizes[0] == sizes[1]
    assert begun(wanted)[1][1] is not None
    (tmp_path / "config.toml").write_text(to_toml(trained))
    with pytest.raises(PolicyError, match="fits no type"):
        begun(wanted)


@pytest.mark.parametrize("name", ["n" * 5000, "nobody/nowhere.safetensors"])
def test_odd_names_are_refused_in_one_sentence(name):
    """So is a name that no file system takes."""
    with pytest.raises(PolicyError, match="is neither a policy that ships nor a readable file"):
        begun({"algorithm.start_policy": name})


def test_an_actor_that_a_type_shares_becomes_one_of_each_agent():
    """Equal rows for all agents, and of their own memory."""
    actors, _ = load_policy(TRAINED)
    config, found = begun({"algorithm.start_policy": "trained", "algorithm.parameters": "separate"})
    for flat, own, group in zip(found, actors.flat, farm_team(config.farm).groups, strict=True):
        np.testing.assert_array_equal(flat, np.repeat(own, group.count, axis=0))
        assert flat.flags.writeable


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"algorithm.start_policy": "nobody"}, "'nobody' is neither a policy that ships nor a readable file"),
        ({"algorithm.start_policy": "trained", "algorithm.hidden": 32}, "fits no type of this run"),
        ({"algorithm.start_policy": "trained", "algorithm.memory": "gru"}, "fits no type of this run"),
        ({"algorithm.start_policy": "trained:eia-sec"}, "fits no type of this run"),
    ],
)
def test_a_policy_that_cannot_be_begun_with_is_refused(values, said):
    """One sentence says why."""
    with pytest.raises(PolicyError, match=said):
        begun(values)


def test_agents_with_actors_of_their_own_do_not_become_one(tmp_path):
    """Nobody could say which of them a shared actor should begin as."""
    team = farm_team(preset("default").farm)
    save_policy(tmp_path / "own.safetensors", TeamActors.initial(team, 64, 3, per_type=False), {})
    values = {"algorithm.start_policy": str(tmp_path / "own.safetensors")}
    with pytest.raises(PolicyError, match="fits no type"):
        begun(values)
    config, found = begun({**values, "algorithm.parameters": "separate"})
    assert [len(flat) for flat in found if flat is not None] == [group.count for group in farm_team(config.farm).groups]
