"""The vector environment: no copies, the same episodes as elsewhere, and Gymnasium's three autoreset modes."""

import copy
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers.vector import DictInfoToList

from eia_sec.common.config import WorldConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, SimulationError
from eia_sec.rollout.envs.parallel_env import parallel_env
from eia_sec.rollout.envs.vector import INFO_ARRAYS, FarmVectorEnv
from eia_sec.rollout.sim.batch import FarmBatch

STEPS = 8
SHORT = replace(preset("study").farm, world=WorldConfig(steps=STEPS, start_levels="random"))
COUNT = 3
MODES = list(AutoresetMode)


def actions(seed, count=COUNT):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 24)).astype(np.float32)


def row(observations):
    return np.concatenate([part.reshape(len(part), -1) for part in observations.values()], axis=1)


def shared(observations, batch):
    return all(np.shares_memory(part, batch.observation) for part in observations.values())


def test_it_has_gymnasiums_contract():
    """It is a VectorEnv whose results lie in its spaces, and whose dictionaries keep the order of a row."""
    envs = FarmVectorEnv(COUNT, SHORT)
    assert isinstance(envs, VectorEnv)
    assert list(envs.observation_space) == list(envs.action_space) == ["communication", "monitoring", "collection"]
    assert envs.single_observation_space["collection"].shape == (4, 42)
    assert envs.observation_space["collection"].shape == (COUNT, 4, 42)
    assert envs.single_action_space["monitoring"].shape == (4, 2)
    observations, _ = envs.reset(seed=0)
    assert observations in envs.observation_space
    envs.action_space.seed(0)
    for _ in range(2 * STEPS):
        observations, rewards, terminations, truncations, _ = envs.step(envs.action_space.sample())
        assert observations in envs.observation_space
        assert (rewards.shape, rewards.dtype) == ((COUNT, 12), np.float32)
        assert terminations.tolist() == [False] * COUNT
        assert (truncations.shape, truncations.dtype) == ((COUNT,), np.bool_)
    envs.close()
    assert envs.closed


@pytest.mark.parametrize("mode", MODES)
def test_nothing_is_copied(mode):
    """Observations, rewards and infos share the simulator's memory, and a row of actions is not copied."""
    envs = FarmVectorEnv(COUNT, SHORT, autoreset_mode=mode)
    observations, infos = envs.reset(seed=0)
    assert shared(observations, envs.batch)
    for step in range(STEPS - 1):
        observations, rewards, _, _, infos = envs.step(actions(step))
        assert shared(observations, envs.batch)
        assert np.shares_memory(rewards, envs.batch.reward)
        for name in INFO_ARRAYS:
            assert np.shares_memory(infos[name], getattr(envs.batch, name))
            assert not infos[name].flags.writeable
        np.testing.assert_array_equal(row(observations), envs.batch.observation)


def test_observations_and_rewards_may_be_overwritten():
    """The simulator never reads them, so scaling them in place is safe."""
    one, other = FarmVectorEnv(COUNT, SHORT), FarmVectorEnv(COUNT, SHORT)
    for envs in (one, other):
        envs.reset(seed=0)
    for step in range(STEPS - 1):
        (ours, rewards, *_), (theirs, expected, *_) = (envs.step(actions(step)) for envs in (one, other))
        np.testing.assert_array_equal(row(ours), row(theirs))
        np.testing.assert_array_equal(rewards, expected)
        for part in ours.values():
            part[...] = np.nan
        rewards[...] = np.nan


def test_a_step_equals_the_batch_and_the_parallel_environment():
    """Environment e of seed s is the ParallelEnv of seed s + e, over two episodes, and both are FarmBatch."""
    envs = FarmVectorEnv(COUNT, SHORT, autoreset_mode="SameStep")
    batch, singles = FarmBatch(SHORT, COUNT), [parallel_env(SHORT) for _ in range(COUNT)]
    envs.reset(seed=40)
    begun = [single.reset(seed=40 + index) for index, single in enumerate(singles)]
    for episode in range(2):
        for index, (_, infos) in enumerate(begun):
            batch.reset(index, infos["collection_0"]["farm"], infos["collection_0"]["episode"])
        for step in range(STEPS):
            chosen = actions((episode, step))
            batch.step(chosen)
            observations, rewards, _, truncations, infos = envs.step(chosen)
            last = step == STEPS - 1
            seen = infos["final_obs"] if last else [{k: v[e] for k, v in observations.items()} for e in range(COUNT)]
            np.testing.assert_array_equal(rewards, batch.reward)
            assert truncations.tolist() == batch.truncated.tolist() == [last] * COUNT
            for index, single in enumerate(singles):
                taken = {name: chosen[index, 2 * k : 2 * k + 2] for k, name in enumerate(single.agents)}
                theirs, paid, *_ = single.step(taken)
                flat = np.concatenate([part.reshape(-1) for part in seen[index].values()])
                np.testing.assert_array_equal(flat, batch.observation[index])
                np.testing.assert_array_equal(flat, np.concatenate(list(theirs.values())))
                assert list(paid.values()) == rewards[index].tolist()
        begun = [single.reset() for single in singles]
        for index, (start, _) in enumerate(begun):
            np.testing.assert_array_equal(row(observations)[index], np.concatenate(list(start.values())))


def test_same_step_keeps_the_last_observation_and_info():
    """The step that ends an episode returns the next one's start, and the end in final_obs and final_info."""
    envs = FarmVectorEnv(COUNT, SHORT)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    envs.reset(seed=0)
    for step in range(STEPS):
        observations, rewards, _, truncations, infos = envs.step(actions(step))
    assert truncations.all()
    assert infos["_final_obs"].all()
    assert (envs.batch.time == 0).all()
    assert shared(observations, envs.batch)
    assert not np.shares_memory(rewards, envs.batch.reward)
    assert rewards.any()
    assert infos["final_info"]["energy"].all()
    assert not infos["energy"].any()
    assert [summary.steps for summary in infos["final_info"]["summary"]] == [STEPS] * COUNT
    totals = infos["final_info"]["summary"][0].reward
    assert len(totals) == 12
    _, _, _, truncations, infos = envs.step(actions(0))
    assert not truncations.any()
    assert "final_obs" not in infos


def test_next_step_begins_in_the_next_call():
    """The call after the end ignores the action, pays nothing and returns the next episode's start."""
    envs, expected = (FarmVectorEnv(COUNT, SHORT, autoreset_mode=mode) for mode in ("NextStep", "SameStep"))
    envs.reset(seed=0)
    expected.reset(seed=0)
    for step in range(STEPS):
        observations, _, _, truncations, infos = envs.step(actions(step))
        start, *_ = expected.step(actions(step))
    assert truncations.all()
    assert infos["_summary"].all()
    assert infos["summary"][1].steps == STEPS
    assert "final_obs" not in infos
    assert not np.array_equal(row(observations), row(start))
    observations, rewards, _, truncations, _ = envs.step(actions(99))
    np.testing.assert_array_equal(row(observations), row(start))
    assert not rewards.any()
    assert not truncations.any()
    ours, theirs = envs.step(actions(5)), expected.step(actions(5))
    np.testing.assert_array_equal(row(ours[0]), row(theirs[0]))
    np.testing.assert_array_equal(ours[1], theirs[1])


@pytest.mark.parametrize("mode", MODES)
def test_environments_out_of_step(mode):
    """After a partial reset episodes end at different times, and every environment still flies its own episodes."""
    envs = FarmVectorEnv(COUNT, SHORT, autoreset_mode=mode)
    envs.reset(seed=0)
    for step in range(3):
        envs.step(actions(step))
    before = envs.batch.observation[[0, 2]].copy()
    mask = np.array([False, True, False])
    envs.reset(seed=[None, 70, None], options={"reset_mask": mask})
    np.testing.assert_array_equal(envs.batch.observation[[0, 2]], before)
    assert envs.batch.time.tolist() == [3, 0, 3]
    single = parallel_env(SHORT)
    single.reset(seed=70)
    resets = {AutoresetMode.SAME_STEP: 0, AutoresetMode.NEXT_STEP: 1, AutoresetMode.DISABLED: 0}[mode]
    for step in range(STEPS):
        observations, rewards, _, truncations, infos = envs.step(actions(step))
        theirs, paid, *_ = single.step({a: actions(step)[1, 2 * k : 2 * k + 2] for k, a in enumerate(single.agents)})
        if step < STEPS - 1:
            np.testing.assert_array_equal(row(observations)[1], np.concatenate(list(theirs.values())))
        assert rewards[1].tolist() == list(paid.values())
        assert truncations.tolist() == [step == 4, step == 7, step == 4]
        if mode is AutoresetMode.NEXT_STEP and step == 5:
            assert envs.batch.time.tolist() == [0, 6, 0]
            assert not rewards[[0, 2]].any()
        if mode is AutoresetMode.DISABLED and step == 4:
            with pytest.raises(SimulationError, match=r"environments \[0, 2\] have ended"):
                envs.step(actions(0))
            envs.reset(options={"reset_mask": ~mask})
    assert envs.batch.time[0] == 3 - resets
    if mode is AutoresetMode.SAME_STEP:
        assert infos["final_obs"][0] is None
        flat = np.concatenate([part.reshape(-1) for part in infos["final_obs"][1].values()])
        np.testing.assert_array_equal(flat, np.concatenate(list(theirs.values())))


def test_actions_by_type_equal_a_row():
    """Both forms of action give the same step."""
    one, other = FarmVectorEnv(COUNT, SHORT), FarmVectorEnv(COUNT, SHORT)
    for envs in (one, other):
        envs.reset(seed=0)
    for step in range(STEPS - 1):
        names = [group.name for group in one.batch.team.groups]
        by_type = dict(zip(names, one.batch.team.split_actions(actions(step)), strict=True))
        np.testing.assert_array_equal(row(one.step(actions(step))[0]), row(other.step(by_type)[0]))


def test_options_choose_farms_and_episodes():
    """One seed for all, or one for each."""
    envs = FarmVectorEnv(COUNT, SHORT)
    envs.reset(seed=0, options={"farm": 1000, "episode": [7, 8, 9]})
    for index in range(COUNT):
        summary = envs.batch.summary(index)
        assert (summary.farm, summary.episode) == (1000, 7 + index)


def test_misuse_is_refused():
    """Steps before a reset, wrong shapes, seeds, masks, modes and counts: one clear error each."""
    envs = FarmVectorEnv(COUNT, SHORT)
    with pytest.raises(SimulationError):
        envs.step(actions(0))
    envs.reset(seed=0)
    for wrong in (actions(0)[:2], actions(0).astype(np.float64), {"monitoring": np.zeros((COUNT, 4, 2))}):
        with pytest.raises(SimulationError):
            envs.step(wrong)
    sample = envs.action_space.sample()
    with pytest.raises(SimulationError, match="type monitoring have shape"):
        envs.step({**sample, "monitoring": sample["monitoring"][:2]})
    with pytest.raises(SimulationError, match="2 seeds for 3"):
        envs.reset(seed=[1, 2])
    with pytest.raises(SimulationError, match="whole number"):
        envs.reset(seed=[1, 2, -3])
    with pytest.raises(SimulationError, match="reset_mask"):
        envs.reset(options={"reset_mask": [True, False, True]})
    with pytest.raises(SimulationError, match="neither one seed nor 3"):
        envs.reset(options={"farm": [1, 2]})
    assert (envs.batch.time == 0).all()
    with pytest.raises(ConfigError, match="autoreset"):
        FarmVectorEnv(COUNT, SHORT, autoreset_mode="Sometimes")
    with pytest.raises(ConfigError, match="0 to 2"):
        FarmVectorEnv(COUNT, SHORT, render_mode="rgb_array", rendered=[3])
    with pytest.raises(SimulationError):
        FarmVectorEnv(0, SHORT)


def test_it_is_registered():
    """Gymnasium makes it by name, warns of nothing, and its wrappers understand the infos."""
    name = "eia_sec.rollout.envs.registration:eia-sec/Farm-v0"
    envs = gymnasium.make_vec(name, num_envs=COUNT, config=SHORT, autoreset_mode="SameStep")
    assert isinstance(envs.unwrapped, FarmVectorEnv)
    listed = DictInfoToList(envs)
    listed.reset(seed=0)
    for step in range(STEPS):
        *_, infos = listed.step(actions(step))
    assert infos[2]["final_obs"]["collection"].shape == (4, 42)


def test_pictures_of_chosen_environments():
    """`render` shows just the environments that were asked for, each its own."""
    envs = FarmVectorEnv(COUNT, SHORT, render_mode="rgb_array", rendered=[0, 2])
    envs.reset(seed=0)
    envs.step(actions(0))
    frames = envs.render()
    assert len(frames) == 2
    assert not np.array_equal(*frames)
    envs.close()
    assert FarmVectorEnv(COUNT, SHORT).render() is None


def test_a_copy_is_an_environment_of_its_own():
    """Stepping a copy moves the copy's observations, infos and clock, and leaves the original as it was."""
    env = FarmVectorEnv(2, SHORT)
    env.reset(seed=1)
    action = np.full((2, env.batch.team.environment_action_size), 0.5, np.float32)
    env.step(action)
    twin = copy.deepcopy(env)
    before = {name: view.copy() for name, view in env.step(action)[0].items()}
    for name, view in twin.step(action)[0].items():
        np.testing.assert_array_equal(view, before[name])
    again, _, _, _, later = twin.step(action)
    assert any((again[name] != before[name]).any() for name in again)
    assert int(twin.batch.time[0]) == int(env.batch.time[0]) + 1
    assert (later["energy"] == twin.batch.energy).all()
    for name, view in env._views.items():
        np.testing.assert_array_equal(view, before[name])
