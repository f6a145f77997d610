"""Any PettingZoo parallel environment is a batch of environments like the farm."""

import importlib
import itertools
import sys
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gymnasium import spaces
from mytask.env import Cover

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EnvConfig, ReplayConfig, RolloutConfig, RunConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, ContractError, SimulationError, UsageError
from eia_sec.common.farm import farm_of
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.messages import Envelope
from eia_sec.common.transitions import LARGEST, TERMINATED, TRANSITION, TRUNCATED
from eia_sec.learner.intake.episode_tracker import EpisodeTracker
from eia_sec.rollout.envs import registry
from eia_sec.rollout.envs.pettingzoo_actions import RowActions
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch
from eia_sec.rollout.envs.pettingzoo_observations import AgentView, RowObservations
from eia_sec.rollout.envs.pettingzoo_spec import make_parallel
from eia_sec.rollout.envs.registry import environment_spec, make_environments
from eia_sec.rollout.evaluation import evaluate_run
from eia_sec.rollout.heuristics.random import RandomPolicy
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.worker.collector import Collector, run_noise_free_episodes
from tests.rollout.heuristics.small_farm import SMALL


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    yield
    sys.modules.pop("toy_env", None)


def relay(arguments="{}", **others):
    return EnvConfig(name="toy_env:Relay", arguments=arguments, **others)


def test_agents_become_types_in_order_of_appearance():
    """A type is a name without its number; its observations are flattened as Gymnasium does."""
    team = PettingZooBatch(relay(), 1).team
    assert [(g.name, g.count, g.observation_size, g.action_size) for g in team.groups] == [
        ("runner", 2, 2, 2),
        ("keeper", 1, 4, 2),
    ]


def test_a_given_map_decides_the_types():
    """The longest prefix wins, and agents of other sizes than their fellows form a type of their own."""
    team = PettingZooBatch(relay(types={"r": "all", "runner_1": "last", "keeper": "all"}), 1).team
    assert [(g.name, g.count) for g in team.groups] == [("all-2x2", 1), ("all-4x2", 1), ("last", 1)]
    odd = PettingZooBatch(relay('{"odd": true}'), 1).team
    assert [(g.name, g.observation_size) for g in odd.groups] == [("runner-2x2", 2), ("keeper", 4), ("runner-3x2", 3)]


def test_actions_are_spread_over_the_box_and_rewards_reach_their_agents():
    """-1..1 becomes low..high; the row's order is by type, the environment's is not."""
    batch = PettingZooBatch(relay(), 1)
    batch.reset(0, 1, 2)
    batch.step(np.array([[-1.0, 0.0, 0.0, 1.0, 1.0, -0.5]], np.float32))
    taken = batch._environments[0].wrapped.actions[0]
    np.testing.assert_allclose(taken["runner_0"], [0.0, 2.0])
    np.testing.assert_allclose(taken["runner_1"], [0.5, 6.0])
    np.testing.assert_allclose(taken["keeper_0"], [1.0, 0.0])
    np.testing.assert_allclose(batch.reward, [[0.0 + 0, 0.5 + 2, 1.0 + 1]])
    assert batch.summary(0).reward == pytest.approx((0.0, 2.5, 2.0))


def test_who_has_left_is_seen_as_zeros_and_earns_nothing():
    """The episode goes on for the others and ends with the last of them."""
    batch = PettingZooBatch(relay(), 1)
    batch.reset(0, 1, 2)
    for _ in range(4):
        batch.step(np.zeros((1, 6), np.float32))
    assert not batch.ended[0]
    np.testing.assert_array_equal(batch.observation[0, :4], 0.0)
    np.testing.assert_array_equal(batch.observation[0, 4:], [0.0, 1.0, 0.0, 4.0])
    np.testing.assert_allclose(batch.reward[0], [0.0, 0.0, 1.5])
    batch.step(np.zeros((1, 6), np.float32))
    assert batch.ended[0]
    assert batch.terminated[0]


@pytest.mark.parametrize(
    ("config", "terminated", "steps"),
    [(relay(), True, 5), (relay('{"cut": true}'), False, 5), (relay(steps=2), False, 2)],
)
def test_terminated_and_truncated_are_distinguished(config, terminated, steps):
    """An end by the environment's own time limit, or by ours, is bootstrapped from."""
    batch = PettingZooBatch(config, 1)
    batch.reset(0, 0, 0)
    while not batch.ended[0]:
        batch.step(np.zeros((1, 6), np.float32))
    assert (bool(batch.terminated[0]), int(batch.time[0])) == (terminated, steps)


def test_an_episode_is_a_function_of_its_seeds():
    """Equal seeds, equal observations; the environment's own seed follows from both."""
    batch = PettingZooBatch(EnvConfig("mpe2:simple_spread_v3"), 3)
    for index, seeds in enumerate([(1, 5), (1, 5), (1, 6)]):
        batch.reset(index, *seeds)
    np.testing.assert_array_equal(batch.observation[0], batch.observation[1])
    assert (batch.observation[0] != batch.observation[2]).any()


@pytest.mark.parametrize(
    ("config", "text"),
    [
        (EnvConfig("nowhere:env"), "there is no environment nowhere:env"),
        (EnvConfig("toy_env:absent"), "there is no environment toy_env:absent"),
        (EnvConfig("toy_env:np"), "neither a callable nor a module with a parallel_env"),
        (EnvConfig("toy_env:Whole"), r"Whole\(\) gave <toy_env.Whole .*; PettingZoo asks for a pettingzoo.ParallelEnv"),
        (relay('{"speed": 3}'), r"toy_env:Relay: Relay\(speed=3\) raised TypeError"),
        (EnvConfig("toy_env:shouting"), "actions other than bounded boxes, Discrete and MultiDiscrete"),
        (EnvConfig("toy_env:Nobody"), "possible_agents gave None; PettingZoo asks for a list"),
        (relay(types={"runer": "r"}), r"names the prefix 'runer', but the agents are runner_0, keeper_0, runner_1"),
        (relay(types={"runner": "mean"}), "no type can be called 'mean'"),
    ],
)
def test_what_cannot_be_trained_is_said_in_one_sentence(config, text):
    """Unknown names, wrong arguments and other action spaces are the user's mistakes."""
    with pytest.raises(UsageError, match=text):
        PettingZooBatch(config, 1)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"name": "mpe-2"}, "module:name"),
        ({"name": "os:system('x')"}, "module:name"),
        ({"arguments": "{"}, "not JSON"),
        ({"arguments": "[1]"}, "JSON object"),
        ({"types": "a=b"}, "types must be a map, not 'a=b'"),
        ({"types": {"a": ""}}, "which is no name"),
        ({"steps": -1}, "between 0"),
    ],
)
def test_impossible_configurations_are_refused(fields, text):
    """Names, arguments, types and steps are checked when the configuration is made."""
    with pytest.raises(ConfigError, match=text):
        EnvConfig(**fields)


def test_boxes_wider_than_float32_are_not_bounded():
    """Their width is infinite in 32-bit floats."""
    with pytest.raises(ConfigError, match="actions other than bounded boxes"):
        PettingZooBatch(EnvConfig("toy_env:wide"), 1)


def test_numbers_alone_are_one_type():
    """Agents named 0 and 1 differ only in their number."""
    team = PettingZooBatch(EnvConfig("toy_env:numbered"), 1).team
    assert [(g.name, g.count) for g in team.groups] == [("agent", 2)]


def test_environments_of_an_evaluation_are_closed():
    """Environments are closed after noise-free episodes and evaluations."""
    import toy_env  # noqa: PLC0415  # only importable inside the fixture

    config = run_config(relay())
    run_noise_free_episodes(config, TeamActors.initial(environment_spec(config).team, 4, 0), (0, 1), (5, 6))
    evaluate_run(config, RandomPolicy(), (7,), 1, name="random")
    assert toy_env.Relay.opened == toy_env.Relay.closed > 0


def test_environments_with_a_choice_are_asked_for_boxes():
    """An environment that acts in another space by default is made once more with continuous actions."""
    assert PettingZooBatch(EnvConfig("toy_env:shy"), 1).team.agents == 3


def test_misuse_is_a_typed_error():
    """Wrong shapes, numbers that are not finite, a step before the reset or after the end."""
    batch = PettingZooBatch(relay(), 2)
    with pytest.raises(SimulationError, match="before its reset"):
        batch.step(np.zeros((2, 6), np.float32))
    batch.reset(0, 0, 0)
    batch.reset(1, 0, 0)
    with pytest.raises(SimulationError, match="shape"):
        batch.step(np.zeros((2, 5), np.float32))
    with pytest.raises(SimulationError, match="finite"):
        batch.step(np.full((2, 6), np.nan, np.float32))
    with pytest.raises(SimulationError, match="at least one"):
        PettingZooBatch(relay(), 0)


def run_config(config, steps=4, environments=2):
    return replace(
        preset("eia-sec"),
        env=config,
        rollout=RolloutConfig(environments=environments, chunk_steps=steps),
        replay=ReplayConfig(capacity=256),
    )


@pytest.mark.parametrize("steps", [1, 4, 5, 7, 23])
def test_chunks_hold_whole_segments_wherever_episodes_end(steps):
    """However chunks are cut, the rows are those of the episodes in turn, each with its final observation."""
    config = run_config(relay('{"cut": true}'), steps, 3)
    collector = Collector(config, "w", 0)
    actors = TeamActors.initial(collector.team, 4, 0)
    per_environment: list[list[tuple]] = [[] for _ in range(3)]
    episodes = []
    for _ in range(12):
        chunk = collector.collect(actors, 0.1, uniform=False)
        chunk.rows.check(collector.team)
        assert chunk.rows.steps == 3 * steps
        episodes += chunk.episodes
        cuts = np.flatnonzero(chunk.rows.flag & TRANSITION == 0)
        first, environment, done = 0, 0, 0
        for last in cuts:
            part = slice(first, last)
            done += last - first
            flags = chunk.rows.flag[part]
            assert (flags[:-1] == TRANSITION).all()
            for k in range(first, last):
                per_environment[environment].append(
                    (chunk.rows.observation[k], chunk.rows.observation[k + 1], chunk.rows.reward[k], chunk.rows.flag[k])
                )
            first = last + 1
            if done == steps:
                environment, done = environment + 1, 0
        assert environment == 3
    for transitions in per_environment:
        keeper = [int(row[0][7]) for row in transitions]
        assert keeper == [k % 5 for k in range(len(keeper))]
        assert [int(row[1][7]) for row in transitions] == [k % 5 + 1 for k in range(len(keeper))]
        ends = [bool(row[3] & TRUNCATED) for row in transitions]
        assert ends == [k % 5 == 4 for k in range(len(keeper))]
        assert not any(row[3] & TERMINATED for row in transitions)
    assert len(episodes) == 3 * (12 * steps // 5)
    assert all(episode.steps == 5 for episode in episodes)


@pytest.mark.parametrize("cut", [1, 4, 5, 6, 19])
def test_a_chunk_that_is_cut_holds_the_first_steps_of_a_whole_one(cut):
    """Its rows are whole segments of all environments, the learner takes it, and the next chunk goes on after it."""
    config = run_config(relay('{"cut": true}'), 20, 3)
    long, short = (Collector(config, "w", 0) for _ in range(2))
    actors, made = TeamActors.initial(long.team, 4, 0), itertools.count(1)
    whole = long.collect(actors, 0.3, uniform=False)
    parts = [short.collect(actors, 0.3, uniform=False, goes_on=lambda: next(made) != cut) for _ in range(2)]
    assert [part.rows.steps for part in parts] == [3 * cut, 3 * 20]
    tracker, steps = EpisodeTracker(ChunkRules.of(config, long.environments.spec)), []
    for number, part in enumerate(parts, start=1):
        part.rows.check(long.team)
        sender = Envelope("rollout", "w", 1, number)
        tracker.follow(sender, tracker.check(sender, part))
    for chunk in (whole, *parts):
        step = chunk.rows.flag & TRANSITION != 0
        steps.append(np.concatenate([chunk.rows.observation, chunk.rows.reward], axis=1)[step].reshape(3, -1, 11))
    np.testing.assert_array_equal(np.concatenate(steps[1:], axis=1)[:, :20], steps[0])
    assert (parts[0].episodes + parts[1].episodes)[: len(whole.episodes)] == whole.episodes


def test_collecting_does_not_depend_on_where_chunks_are_cut():
    """The same episodes and the same noise, whatever the chunk's length."""
    long, short = (Collector(run_config(relay(), steps), "w", 0) for steps in (20, 5))
    actors = TeamActors.initial(long.team, 4, 0)
    whole = long.collect(actors, 0.3, uniform=False)
    parts = [short.collect(actors, 0.3, uniform=False) for _ in range(4)]
    acted = [chunk.rows.reward[chunk.rows.flag & TRANSITION != 0] for chunk in (whole, *parts)]
    first = np.concatenate([part[:5] for part in acted[1:]])
    np.testing.assert_array_equal(acted[0][:20], first)


def test_noise_free_flights_may_differ_in_length():
    """Rewards after an episode's end are zeros, and the steps of each are returned."""
    config = run_config(EnvConfig("toy_env:Relay", steps=4))
    actors = TeamActors.initial(environment_spec(config).team, 4, 0)
    reward, steps = run_noise_free_episodes(config, actors, (0, 1), (5, 6))
    assert reward.shape == (2, 4, 3)
    np.testing.assert_array_equal(steps, 4)
    assert not reward[:, 3, :2].any()


def test_evaluation_names_the_types():
    """Random actions on three scenarios: reward by type, steps, no metrics."""
    result = evaluate_run(run_config(relay()), RandomPolicy(), (7, 8, 9), 2, name="random").to_dict()
    assert set(result["reward"]) == {"mean", "runner", "keeper"}
    assert result["steps"] == 5.0
    again = evaluate_run(run_config(relay()), RandomPolicy(), (7, 8, 9), 2, name="random").to_dict()
    assert again == result


def test_the_farm_is_one_of_them():
    """The farm needs no PettingZoo and is the default."""
    assert make_environments(RunConfig(), 2).team.agents == 12


def test_a_line_in_factories_is_all_that_an_environment_of_this_package_needs(monkeypatch):
    """Its name has no colon, so it is not third-party code, and a run that names it is not about the farm."""
    config = RunConfig(env=EnvConfig("small_farm"))
    monkeypatch.setitem(
        registry.FACTORIES, "small_farm", lambda run, count, hindsight: FarmBatch(SMALL, count, 1, hindsight)
    )
    with closing(make_environments(config, 2)) as environments:
        assert environments.team == FarmBatch(SMALL, 1).team
    assert not config.env.is_third_party
    assert farm_of(config) is None


def test_a_name_that_nothing_has_registered_is_refused():
    """The sentence lists the environments of this package."""
    with pytest.raises(ConfigError, match=r"module:name or an environment of this package \(farm\), not 'mpe2'"):
        make_environments(RunConfig(env=EnvConfig("mpe2")), 1)


def test_who_has_left_earns_nothing_whatever_the_environment_says():
    """An environment that goes on to name agents that have left pays and shows them nothing."""
    batch = PettingZooBatch(EnvConfig("toy_env:Lingering"), 1)
    batch.reset(0, 1, 2)
    for _ in range(4):
        batch.step(np.zeros((1, 6), np.float32))
    np.testing.assert_array_equal(batch.observation[0, :4], 0.0)
    np.testing.assert_allclose(batch.reward[0], [0.0, 0.0, 1.5])


def test_an_episode_ends_with_everybody_although_nobody_is_removed():
    """An environment that keeps everybody in its list has ended when all have terminated or were truncated."""
    batch = PettingZooBatch(EnvConfig("toy_env:Standing", arguments='{"leave": 5}'), 1)
    batch.reset(0, 1, 2)
    for _ in range(5):
        assert not batch.ended[0]
        batch.step(np.zeros((1, 6), np.float32))
    assert (bool(batch.ended[0]), bool(batch.terminated[0])) == (True, True)


def test_an_environment_that_is_not_taken_is_closed():
    """One that acts in boxes replaces one that does not, and of a refused one nothing is left open."""
    toy_env = importlib.import_module("toy_env")
    for name, kept in (("toy_env:shy", 1), ("toy_env:shouting", 0)):
        toy_env.Relay.opened = toy_env.Relay.closed = 0
        with suppress(ConfigError):
            make_parallel(EnvConfig(name))
        assert toy_env.Relay.opened - toy_env.Relay.closed == kept


def test_an_observation_outside_its_space_is_a_typed_error():
    """The agent is named."""
    batch = PettingZooBatch(EnvConfig("toy_env:Wandering"), 1)
    batch.reset(0, 1, 2)
    batch.step(np.zeros((1, 6), np.float32))
    with pytest.raises(ContractError, match=r"step\(\) returned the observation .* of agent keeper_0"):
        batch.step(np.zeros((1, 6), np.float32))


@pytest.mark.parametrize(
    ("space", "sent", "wanted"),
    [
        (spaces.Box(0, 3, (1,), np.int64), [-1.0, -0.4, 0.4, 0.9], [0, 1, 2, 3]),
        (spaces.Box(-1, 1, (1,), np.int8), [-0.9, 0.1, 0.9], [-1, 0, 1]),
        (spaces.Box(-0.1, 0.1, (1,), np.float64), [-1.0, 1.0], [-0.1, 0.1]),
    ],
)
def test_actions_in_boxes_reach_every_value_and_stay_inside(space, sent, wanted):
    """Whole numbers are rounded, and no bound is left by the rounding of 32-bit numbers."""
    adapter = RowActions({"a": space})
    for number, value in zip(sent, wanted, strict=True):
        (row,) = adapter.in_range(np.array([[number]], np.float32))
        action = adapter.by_agent(row, {"a"})["a"]
        assert space.contains(action)
        assert action[0] == value


class Shifted(Cover):
    """Its actions and what it sees begin at an argument."""

    def __init__(self, low=0, seen=1.0):
        super().__init__()
        self.low, self.seen = low, seen

    def action_space(self, agent):
        return spaces.Discrete(3, start=self.low)

    def observation_space(self, agent):
        return spaces.Box(-self.seen, self.seen, (4,), np.float32)


def test_other_arguments_keep_the_actions():
    """Arguments may change what can be seen, and not the actions, which other environments are still taking."""
    with closing(PettingZooBatch(EnvConfig("mytask.env:Cover"), 2, boxes=False, make=Shifted)) as batch:
        batch.reset(0, 0, 0)
        batch.change_arguments('{"seen": 2.0}')
        batch.reset(1, 0, 0)
        assert [environment.wrapped.seen for environment in batch._environments] == [1.0, 2.0]
        batch.change_arguments('{"low": 1}')
        with pytest.raises(ConfigError, match="other action spaces"):
            batch.reset(1, 0, 1)
        assert batch._actions.by_agent(np.zeros(2), {"walker_0"}) == {"walker_0": 0}


@pytest.mark.parametrize("space", [spaces.Box(-9, 9, (4,), np.float32), spaces.Box(-9, 9, (2, 3), np.float64)])
@pytest.mark.parametrize("kind", [np.float32, np.float64, np.float16, int, list])
def test_rows_converted_at_once_equal_those_agent_by_agent(space, kind):
    """Whatever type the numbers come in, and whoever is absent."""
    views = {name: AgentView.of(name, space, (), informed=False) for name in "abc"}
    drawn = np.random.default_rng(0).uniform(-9, 9, (3, *space.shape))
    seen = {name: part.tolist() if kind is list else part.astype(kind) for name, part in zip("abc", drawn, strict=True)}
    rows = RowObservations(views)
    wanted = [view.numbers(name, seen[name], {}) for name, view in views.items()]
    np.testing.assert_array_equal(rows.row(seen, {}), np.concatenate(wanted))
    del seen["b"]
    np.testing.assert_array_equal(rows.row(seen, {}), np.concatenate([wanted[0], views["b"].absent(), wanted[2]]))


def test_the_largest_numbers_are_taken_and_larger_ones_named():
    """The test of a whole row neither refuses what an agent alone may show nor takes what it may not."""
    views = {name: AgentView.of(name, spaces.Box(-np.inf, np.inf, (2,)), (), informed=False) for name in "ab"}
    rows, seen = RowObservations(views), {"a": np.full(2, LARGEST, np.float32), "b": np.full(2, -LARGEST, np.float32)}
    np.testing.assert_array_equal(rows.row(seen, {}), [LARGEST, LARGEST, -LARGEST, -LARGEST])
    for number in (np.nextafter(np.float32(LARGEST), np.inf, dtype=np.float32), np.inf, np.nan):
        with pytest.raises(ContractError, match=r"an observation of agent b with .* at index 1; the largest is 1e"):
            rows.row({**seen, "b": np.array([0.0, number], np.float32)}, {})


@pytest.mark.parametrize(
    "spaces_of",
    [
        [spaces.Discrete(3, start=5)] * 3,
        [spaces.Box(-3.0, 0.1, (2,), np.float64)] * 2,
        [spaces.Box(-3.0, 0.1, (2, 1))] * 2,
    ],
)
def test_actions_converted_at_once_are_in_their_spaces(spaces_of):
    """Every number from an actor, ends included, is an action of the agent's own space; who is absent has none."""
    actions = RowActions(dict(enumerate(spaces_of)))
    for row in actions.in_range(np.linspace(-1.5, 3.5, 11, dtype=np.float32)[:, None].repeat(len(actions._low), 1)):
        taken = actions.by_agent(row, range(len(spaces_of)))
        assert all(spaces_of[name].contains(action) for name, action in taken.items())
        assert actions.by_agent(row, {1}).keys() == {1}
