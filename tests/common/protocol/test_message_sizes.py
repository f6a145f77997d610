"""Runs whose messages no frame holds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EiaSecConfig, EliteConfig, IppoConfig, ReplayConfig, RolloutConfig, RunConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import METRIC_NAMES, farm_environment
from eia_sec.common.protocol.chunk_messages import to_message
from eia_sec.common.protocol.message_sizes import actor_bytes, chunk_bytes, evaluation_bytes, require_frames
from eia_sec.common.protocol.messages import EvaluationResult, ParametersMessage
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from eia_sec.rollout.envs.registry import environment_spec

BASE = preset("eia-sec")
FARM = farm_environment(BASE.farm)
TEAM = FARM.team
OTHER = EnvironmentSpec(TEAM, (1, 1000))
"""The same team in episodes of no known length."""
DEEP = ReplayConfig(capacity=10_000_000)


def chunk_size(config, ends):
    """Return the bytes of a chunk in which so many steps of each environment, evenly apart, end an episode."""
    count, steps = config.rollout.environments, config.rollout.chunk_steps
    flag = []
    for step in range(steps):
        last = (step + 1) * ends // steps > step * ends // steps
        flag += [TRANSITION | TRUNCATED, 0] if last else [TRANSITION]
    flag += [] if last else [0]
    shapes = (TEAM.observation_size, TEAM.action_size, TEAM.agents)
    rows = Rows(*(np.zeros((count * len(flag), size), np.float32) for size in shapes), np.array(flag * count, np.uint8))
    rows.check(TEAM)
    ended = EpisodeSummary(0, 0, 1, (0.0,) * TEAM.agents, dict.fromkeys(METRIC_NAMES, 0.0))
    return len(to_message(Chunk(rows, (ended,) * (count * ends)), TEAM, 1, count * steps).encode())


@pytest.mark.parametrize(("environments", "steps", "length"), [(8, 20, 500), (3, 1, 500), (4, 60, 20), (64, 5, 1)])
@pytest.mark.parametrize("known", [True, False])
def test_the_largest_chunk_has_the_computed_size(known, environments, steps, length):
    """Where episodes have a known length, a chunk holds as many ends as fit; elsewhere every step may be the last."""
    config = replace(BASE, rollout=RolloutConfig(environments=environments, chunk_steps=steps))
    environment = replace(FARM, episode_steps=(length, length)) if known else OTHER
    size = chunk_size(config, math.ceil(steps / length) if known else steps)
    assert 0.8 * size < chunk_bytes(config, environment) + 1000
    assert size <= chunk_bytes(config, environment) + 1000 <= 1.3 * size


def test_rounded_observations_halve_a_chunk():
    """The computed size falls by two bytes for each number of an observation."""
    rollout = RolloutConfig(environments=4, chunk_steps=10)
    exact, halved = (
        chunk_bytes(RunConfig(algorithm=IppoConfig(precision=precision), rollout=rollout), FARM)
        for precision in ("float32", "bfloat16")
    )
    assert exact - halved == 2 * TEAM.observation_size * rollout.chunk_rows(1)


@pytest.mark.parametrize("environments", [3, 64])
def test_chunks_with_states_have_the_computed_size(environments):
    """The state of each agent in each environment adds its bytes, and the unit's parameters add theirs."""
    rollout, algorithm = RolloutConfig(environments=environments, chunk_steps=10), IppoConfig(hidden=32)
    plain = RunConfig(algorithm=algorithm, rollout=rollout)
    config = replace(plain, algorithm=replace(algorithm, memory="gru", sequence_steps=10))
    more = chunk_bytes(config, FARM) - chunk_bytes(plain, FARM)
    assert more == np.zeros((environments, TEAM.agents, 32), np.float32).nbytes
    actors = TeamActors.initial(TEAM, 32, 0, head="gaussian", memory="gru")
    assert actor_bytes(config, TEAM) == sum(flat.nbytes for flat in actors.flat)


@pytest.mark.parametrize("hidden", [16, 64])
@pytest.mark.parametrize("head", ["deterministic", "gaussian"])
def test_the_actors_have_the_computed_size(hidden, head):
    """All actors take the computed bytes, but for the room beside them."""
    actors = TeamActors.initial(TEAM, hidden, 0, head=head)
    size = len(ParametersMessage(1, 1, 0, 0, 0.0, TEAM.digest, actors.hidden, actors.head, actors.flat).encode())
    assert size <= actor_bytes(replace(BASE, algorithm=EiaSecConfig(hidden=hidden)), TEAM) + 1000 <= 1.2 * size


def test_evaluations_have_the_computed_size():
    """Of no more farms than are trained on; without imitation, and where episodes have no known length, none."""
    few = replace(BASE, elite=EliteConfig(farms=50), rollout=RolloutConfig(train_farms=7))
    result = EvaluationResult(1, 1, np.zeros((7, 500, TEAM.agents), np.float32), np.full(7, 500))
    assert 0 < len(result.encode()) - evaluation_bytes(few, FARM) < 1000
    assert evaluation_bytes(replace(few, elite=EliteConfig(enabled=False)), FARM) == 0
    assert evaluation_bytes(few, OTHER) == 0


def test_what_no_frame_holds_is_refused():
    """The sentence says what is too large and what to change; both presets and a large fleet are taken."""
    default = preset("instant")
    require_frames(default, farm_environment(default.farm))
    require_frames(BASE, FARM)
    require_frames(BASE, replace(FARM, team=TeamSpec(tuple(replace(group, count=32) for group in TEAM.groups))))
    wide = RolloutConfig(environments=512, chunk_steps=1000)
    with pytest.raises(ConfigError, match=r"512 environments times 1000 steps .* lower rollout\.chunk_steps"):
        require_frames(replace(BASE, rollout=wide, replay=DEEP), FARM)
    with pytest.raises(ConfigError, match=r"hidden 4096 take \d+ MiB, .* lower algorithm\.hidden"):
        require_frames(replace(BASE, algorithm=EiaSecConfig(hidden=4096)), FARM)
    seen = TeamSpec((GroupSpec("agent", 64, 65_536, 2),))
    with pytest.raises(ConfigError, match="8 environments times 20 steps"):
        require_frames(replace(BASE, algorithm=EiaSecConfig(hidden=1)), replace(FARM, team=seen))
    fleet = TeamSpec(tuple(replace(group, count=12) for group in TEAM.groups))
    long = replace(FARM, team=fleet, episode_steps=(100_000, 100_000))
    with pytest.raises(
        ConfigError, match=r"20 flights of 100000 steps with 36 agents take \d+ MiB, .* lower elite\.farms"
    ):
        require_frames(replace(BASE, elite=EliteConfig(farms=20)), long)
    many = replace(BASE, rollout=RolloutConfig(environments=4096, chunk_steps=20), replay=DEEP)
    require_frames(many, FARM)
    with pytest.raises(ConfigError, match="4096 environments times 20 steps"):
        require_frames(many, OTHER)


def test_a_run_is_refused_where_its_team_is_made():
    """Whoever starts a run asks for its team first."""
    with pytest.raises(ConfigError, match=r"lower algorithm\.hidden"):
        environment_spec(replace(BASE, algorithm=EiaSecConfig(hidden=4096)))
