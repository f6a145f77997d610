"""The PettingZoo environment: its contract, its spaces and infos, and that it is FarmBatch bit for bit."""

import copy
import importlib
import math
import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.env_checker import data_equivalence
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, state_test

from eia_sec.common.config import FarmConfig, ObservationConfig, RadioConfig, RelayConfig, WorldConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, SimulationError
from eia_sec.common.farm_observation import observation_parts
from eia_sec.common.transitions import EpisodeSummary
from eia_sec.rollout.envs.episodes import EpisodeStream
from eia_sec.rollout.envs.parallel_env import env, parallel_env
from eia_sec.rollout.envs.spaces import observation_bounds
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from tests.constants import with_constants

PLAIN = preset("study").farm
SHORT = replace(PLAIN, world=WorldConfig(steps=12, start_levels="random"))
LOPSIDED = replace(
    PLAIN,
    world=with_constants(
        WorldConfig(
            communication_uavs=2,
            monitoring_uavs=1,
            collection_uavs=3,
            field_x=120.0,
            field_y=60.0,
            sensors=12,
            plots_x=3,
            plots_y=2,
            steps=60,
            start_levels="random",
        ),
        height_communication=60.0,
        height_collection=5.0,
    ),
    radio=with_constants(RadioConfig(), sensor_power_dbm=20.0),
    relay=RelayConfig(capacity=4),
)
LONELY = FarmConfig(
    world=WorldConfig(communication_uavs=1, monitoring_uavs=1, collection_uavs=1, sensors=3, steps=40),
    observation=ObservationConfig(sensors=2, form="printed"),
)


def sample(farm):
    return {agent: farm.action_space(agent).sample() for agent in farm.agents}


def flown(farm, steps, seed=0):
    """Reset and fly random steps; return what the last step returned."""
    result = farm.reset(seed=seed)
    for index, agent in enumerate(farm.agents):
        farm.action_space(agent).seed(index)
    for _ in range(steps):
        result = farm.step(sample(farm))
    return result


def test_parallel_api():
    """PettingZoo's own definition of a correct parallel environment, over whole episodes and without a warning."""
    farm = parallel_env()
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        parallel_api_test(farm, num_cycles=600)
    assert farm.batch.truncated.all()


def test_parallel_seed():
    """PettingZoo's test of seeds, which compares one step."""
    made = []
    parallel_seed_test(lambda: made.append(parallel_env()) or made[-1], num_cycles=5)
    assert [farm.batch.time[0] for farm in made] == [1, 1]


def test_equal_seeds_are_equal_to_the_end():
    """Two environments of one seed are equal in everything over two whole episodes."""
    one, other = parallel_env(SHORT), parallel_env(SHORT)
    for seed in (11, None):
        assert data_equivalence(one.reset(seed=seed), other.reset(seed=seed))
        while one.agents:
            actions = sample(one)
            assert data_equivalence(one.step(actions), other.step(actions))


def test_taking_turns(capsys):
    """Converted, it passes PettingZoo's test of environments in which agents take turns."""
    api_test(env(SHORT), num_cycles=200)
    assert "Passed API test" in capsys.readouterr().out


def test_state():
    """The state passes PettingZoo's test and is the row that the learner sees."""
    state_test(env(SHORT), parallel_env(SHORT), num_cycles=20)
    farm = parallel_env(SHORT)
    observations = flown(farm, 3)[0]
    np.testing.assert_array_equal(farm.state(), np.concatenate(list(observations.values())))
    np.testing.assert_array_equal(farm.state(), farm.batch.observation[0])
    with pytest.raises(SimulationError):
        parallel_env(SHORT).state()


def test_it_is_the_simulator_bit_for_bit():
    """Observations, rewards and the end equal those of FarmBatch with the same seeds and actions."""
    farm, batch = parallel_env(SHORT), FarmBatch(SHORT, 1)
    _, infos = farm.reset(seed=5)
    batch.reset(0, infos["monitoring_0"]["farm"], infos["monitoring_0"]["episode"])
    random = np.random.default_rng(0)
    for step in range(1, 13):
        row = random.uniform(-1.3, 1.3, (1, 24)).astype(np.float32)
        batch.step(row)
        actions = {name: row[0, 2 * index : 2 * index + 2] for index, name in enumerate(farm.possible_agents)}
        observations, rewards, terminations, truncations, _ = farm.step(actions)
        np.testing.assert_array_equal(np.concatenate([observations[name] for name in actions]), batch.observation[0])
        assert list(rewards.values()) == batch.reward[0].tolist()
        assert not any(terminations.values())
        assert set(truncations.values()) == {step == 12}


def test_names_are_in_row_order():
    """Agents are named by type and number, in the order of a row."""
    farm = parallel_env(LOPSIDED)
    assert farm.possible_agents == [
        *("communication_0", "communication_1"),
        "monitoring_0",
        *("collection_0", "collection_1", "collection_2"),
    ]
    assert farm.agents == []
    farm.reset(seed=0)
    assert farm.agents == farm.possible_agents
    assert farm.max_num_agents == farm.num_agents == 6


def test_the_end_is_a_truncation_of_all():
    """At the last step all agents are truncated, none terminated; then there is nobody to step, until a reset."""
    farm = parallel_env(SHORT)
    *_, truncations, infos = flown(farm, 12)
    assert farm.agents == []
    assert truncations == dict.fromkeys(farm.possible_agents, True)
    summary = infos["collection_1"]["summary"]
    assert isinstance(summary, EpisodeSummary)
    assert summary == farm.batch.summary(0)
    assert summary.steps == 12
    with pytest.raises(SimulationError, match="Call reset first"):
        farm.step({})
    farm.reset()
    assert farm.agents == farm.possible_agents
    assert "summary" not in farm.step(sample(farm))[4]["collection_1"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda actions: actions.pop("monitoring_2"), "no action for monitoring_2"),
        (lambda actions: actions.update(monitoring_9=np.zeros(2)), "unknown monitoring_9"),
        (lambda actions: actions.update(monitoring_2=np.zeros(3)), r"the action of monitoring_2 has shape \[3\]"),
        (lambda actions: actions.update(monitoring_2=np.zeros((1, 2))), "the action of monitoring_2 has shape"),
        (lambda actions: actions.update(monitoring_2=None), "the action of monitoring_2 has shape"),
        (lambda actions: actions.update(monitoring_2="left"), "monitoring_2 is 'left'"),
        (lambda actions: actions.update(monitoring_2=np.array([0.0, np.nan])), "not finite"),
    ],
)
def test_wrong_actions_are_refused_and_change_nothing(change, message):
    """A missing or unknown agent, another shape, something that is no number: one clear error, and no step."""
    farm = parallel_env(SHORT)
    farm.reset(seed=0)
    actions, before = sample(farm), farm.state()
    change(actions)
    with pytest.raises(SimulationError, match=message):
        farm.step(actions)
    np.testing.assert_array_equal(farm.state(), before)
    assert farm.batch.time[0] == 0


def test_a_step_before_the_first_reset_is_refused():
    """There is no episode yet."""
    with pytest.raises(SimulationError, match="Call reset first"):
        parallel_env(SHORT).step({})


def test_a_seed_begins_a_stream_of_episodes():
    """The same seed repeats the same farms and episodes; other seeds and later episodes are others."""

    def episodes(farm, seed, count=6):
        infos = [farm.reset(seed=seed)[1], *(farm.reset()[1] for _ in range(count - 1))]
        return [(info["monitoring_0"]["farm"], info["monitoring_0"]["episode"]) for info in infos]

    one, other = parallel_env(SHORT), parallel_env(SHORT)
    first = episodes(one, 7)
    assert episodes(other, 7) == first == episodes(one, 7)
    assert episodes(one, 8) != first
    assert len(set(first)) == 6
    assert {farm for farm, _ in first} <= set(range(20))
    assert len({farm for farm, _ in first}) > 1
    assert {farm for farm, _ in episodes(parallel_env(SHORT, farms=[1000, 1001]), 7, 20)} == {1000, 1001}


def test_without_any_seed_environments_differ():
    """Two environments without a seed have different episodes, so workers do not repeat one another."""
    seeds = {parallel_env(SHORT).reset()[1]["monitoring_0"]["episode"] for _ in range(3)}
    assert len(seeds) == 3


def test_options_choose_farm_and_episode():
    """Both options override the stream, which advances all the same; unknown options are ignored."""
    farm = parallel_env(SHORT)
    _, infos = farm.reset(seed=1, options={"farm": np.int64(1234), "episode": 5, "colour": "red"})
    assert {(info["farm"], info["episode"]) for info in infos.values()} == {(1234, 5)}
    second = farm.reset()[1]["monitoring_0"]["episode"]
    farm.reset(seed=1)
    assert farm.reset()[1]["monitoring_0"]["episode"] == second


@pytest.mark.parametrize("wrong", [{"farm": -1}, {"farm": "north"}, {"episode": 0.5}, {"episode": True}])
def test_impossible_options_are_refused(wrong):
    """A seed is a whole number from 0 on."""
    with pytest.raises(SimulationError, match="whole number"):
        parallel_env(SHORT).reset(options=wrong)


def test_impossible_construction_is_refused():
    """No farm, a farm that is no number, an unknown mode, a negative seed."""
    with pytest.raises(ConfigError, match="at least one farm"):
        parallel_env(farms=[])
    with pytest.raises(SimulationError, match="whole number"):
        EpisodeStream([0, "north"])
    with pytest.raises(ConfigError, match="render mode"):
        parallel_env(render_mode="hologram")
    with pytest.raises(SimulationError, match="whole number"):
        parallel_env(SHORT).reset(seed=-1)


@pytest.mark.parametrize(
    "config", [FarmConfig(), SHORT, LOPSIDED, LONELY], ids=["default", "short", "lopsided", "lonely"]
)
@pytest.mark.parametrize("bias", [0.0, 1.0, -1.0])
def test_observations_stay_inside_their_spaces(config, bias):
    """Random flights, also with everybody driven into a corner, never leave the declared bounds."""
    farm = parallel_env(replace(config, world=replace(config.world, steps=min(config.world.steps, 150))))
    observations, _ = farm.reset(seed=2)
    random = np.random.default_rng(3)
    while farm.agents:
        assert all(farm.observation_space(agent).contains(seen) for agent, seen in observations.items())
        assert farm.state_space.contains(farm.state())
        actions = {agent: (bias + random.uniform(-1.0, 1.0, 2)).clip(-1.0, 1.0) for agent in farm.agents}
        observations, *_ = farm.step(actions)


def test_bounds_are_reached_and_right_where_heights_differ():
    """Across the diagonal a UAV at another height is farther than the diagonal, by just what the bound allows."""
    farm = parallel_env(LOPSIDED)
    farm.reset(seed=0)
    batch = farm.batch
    batch.position[0, :2] = 0.0
    batch.position[0, 2:] = (120.0, 60.0)
    still = {agent: np.zeros(2) for agent in farm.agents}
    observations, *_ = farm.step(still)
    seen, space = observations["communication_0"], farm.observation_space("communication_0")
    highest = math.hypot(120.0, 60.0, 55.0) / math.hypot(120.0, 60.0)
    serving = observations["communication_0"] if seen[13] > 0 else observations["communication_1"]
    assert serving[13] == pytest.approx(highest)
    assert serving[13] > 1.0
    assert space.contains(seen)
    assert space.high[13] == np.float32(highest * (1 + 1e-12))
    assert space.high[4] == space.high[16] == 1.0, "the nearest UAV is one of the same plane"


def test_spaces_are_the_parts_of_an_observation():
    """Parts add up to the team's sizes, and spaces are float32 boxes of those bounds, always the same objects."""
    for config in (FarmConfig(), LOPSIDED, LONELY):
        farm = parallel_env(config)
        for group in farm.batch.team.groups:
            assert sum(part.size for part in observation_parts(config, group.name)) == group.observation_size
            space = farm.observation_space(f"{group.name}_0")
            low, high = observation_bounds(config)[group.name]
            np.testing.assert_array_equal(space.low, low)
            np.testing.assert_array_equal(space.high, high)
            assert space.dtype == np.float32
            assert farm.observation_space(f"{group.name}_0") is space
            assert farm.action_space(f"{group.name}_0").shape == (2,)
        assert len({id(space) for space in farm.action_spaces.values()}) == len(farm.possible_agents)


def test_infos_are_the_simulators_arrays():
    """Everything in an info is what FarmBatch says of that agent; relays and served UAVs name each other."""
    farm = parallel_env(replace(SHORT, relay=RelayConfig(capacity=8)))
    farm.reset(seed=4)
    for index, agent in enumerate(farm.agents):
        farm.action_space(agent).seed(index)
    for _ in range(11):
        *_, infos = farm.step(sample(farm))
        batch, relays = farm.batch, farm.possible_agents[:4]
        quality = batch.link_quality[0]
        for index, (name, info) in enumerate(infos.items()):
            assert info["aoi"] == batch.aoi[0].mean()
            assert info["vdf"] == batch.vdf[0].mean()
            assert info["energy"] == batch.energy[0, index] > 0.0
            assert info["utility"] == batch.utility[0, index]
            assert tuple(info["reward_parts"]) == REWARD_PARTS
            assert list(info["reward_parts"].values()) == batch.parts[0, index].tolist()
            assert sum(info["reward_parts"].values()) == pytest.approx(batch.reward[0, index], abs=1e-4)
            if name in relays:
                served = np.flatnonzero(batch.assignment[0] == index)
                assert info["assignment"] == [farm.possible_agents[4 + other] for other in served]
                assert info["link_quality"] == quality[served].tolist()
            else:
                assert info["assignment"] == relays[batch.assignment[0, index - 4]]
                assert info["link_quality"] == quality[index - 4]
                assert name in infos[info["assignment"]]["assignment"]


def test_link_quality_by_hand():
    """100 m apart in space: 20 dBm - (20 lg 0.1 + 20 lg 2800 + 32.44) dB + 100.85 dBm = 39.47 dB; 20 dB a decade."""
    batch = FarmBatch(FarmConfig(), 1)
    batch.reset(0, 0, 0)
    batch.position[0] = 0.0
    batch.position[0, 4, 0] = math.sqrt(100.0**2 - 2.0**2)
    batch.position[0, 8, 1] = math.sqrt(300.0**2 - 4.0**2)
    batch.step(np.zeros((1, 24), np.float32))
    quality = batch.link_quality[0]
    loss = 20.0 * math.log10(0.1) + 20.0 * math.log10(2800.0) + 32.44
    noise = 10.0 * math.log10(1.38e-23 * 298.0 * 20e6 * 1000.0)
    assert noise == pytest.approx(-100.85, abs=0.01)
    assert quality[0] == pytest.approx(20.0 - loss - noise)
    assert quality[0] == pytest.approx(39.47, abs=0.01)
    assert quality[4] == pytest.approx(quality[0] - 20.0 * math.log10(3.0))
    assert np.isfinite(quality).all()


def test_returned_arrays_are_the_callers_own():
    """A later step changes nothing that was returned, and writing to it changes no later step."""
    one, other = parallel_env(SHORT), parallel_env(SHORT)
    observations, _ = one.reset(seed=3)
    other.reset(seed=3)
    kept = copy.deepcopy(observations)
    still = {agent: np.ones(2, np.float32) for agent in one.agents}
    ours, theirs = one.step(still)[0], other.step(still)[0]
    for name, seen in observations.items():
        np.testing.assert_array_equal(seen, kept[name])
        ours[name][:] = 7.0
    ours, theirs = one.step(still)[0], other.step(still)[0]
    for name, seen in theirs.items():
        np.testing.assert_array_equal(ours[name], seen)


def test_a_deep_copy_flies_on_by_itself():
    """Wrappers copy environments: a copy continues as the original would, and neither affects the other."""
    farm = parallel_env(SHORT)
    flown(farm, 4)
    twin = copy.deepcopy(farm)
    actions = sample(farm)
    ours, theirs = farm.step(actions), twin.step(actions)
    for name in farm.agents:
        np.testing.assert_array_equal(ours[0][name], theirs[0][name])
    assert ours[1] == theirs[1]
    farm.step(actions)
    assert (farm.batch.time[0], twin.batch.time[0]) == (6, 5)


def test_it_is_registered():
    """Importing the registration enters the farm in PettingZoo's registry, in both forms."""
    importlib.import_module("eia_sec.rollout.envs.registration")
    assert str(pettingzoo.make("parallel", "eia-sec/Farm-v0", config=SHORT)) == "eia_sec_farm_v0"
    turns = pettingzoo.make("aec", "eia-sec/Farm-v0", config=SHORT)
    turns.reset(seed=0)
    assert turns.agent_selection == "communication_0"


def test_without_rendering_no_drawing_library_is_imported():
    """Training does not import matplotlib."""
    code = (
        "import sys; from eia_sec.rollout.envs.parallel_env import parallel_env; import eia_sec.rollout.envs.vector;"
        "parallel_env().reset(seed=0); sys.exit('matplotlib' in sys.modules or 'pygame' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
