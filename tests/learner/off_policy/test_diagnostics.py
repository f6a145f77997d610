"""Diagnostics of updates: what they say is what plain arithmetic says."""

import struct
from dataclasses import replace

import numpy as np
import pytest
import torch

from eia_sec.common.actors import TeamActors, parameter_views
from eia_sec.common.config import EiaSecConfig, ReplayConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.protocol.metrics import flattened
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Chunk, Rows
from eia_sec.learner.off_policy.diagnostics import (
    RETURN_PERIOD,
    RunningDiagnostics,
    horizon,
    newest_returns,
    realised_returns,
)
from eia_sec.learner.off_policy.engine import Batch, Diagnostics, Engine
from eia_sec.learner.off_policy.replay import Replay
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from eia_sec.learner.process.tensorboard import FOLDER, Event, TensorBoardWriter

TEAM = TeamSpec((GroupSpec("a", 2, 3, 1), GroupSpec("b", 3, 2, 2)))


def batch(rows, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator)

    return Batch(
        normal(rows, TEAM.observation_size),
        normal(rows, TEAM.action_size).tanh(),
        normal(rows, TEAM.agents),
        normal(rows, TEAM.observation_size),
        torch.zeros(rows),
    )


def critic(flat, x, hidden):
    """Return the values of one exported critic, by plain NumPy."""
    w1, b1, w2, b2, w3, b3 = (view[0] for view in parameter_views(flat[None], x.shape[1], hidden, 1))
    h = np.maximum(x @ w1 + b1, 0)
    return (np.maximum(h @ w2 + b2, 0) @ w3 + b3)[:, 0]


def test_spread_is_the_members_standard_deviation():
    """It equals the standard deviation of three members' values at the actors' own actions, computed one by one."""
    config = EiaSecConfig(hidden=8, batch=16, ensemble_members=3, critic_rate=1e-30, actor_rate=1e-30)
    engine, rows = Engine(config, TEAM, 5), batch(16)
    diagnostics = engine.update(rows, diagnostics=True)
    action = np.split(engine_actions(engine, rows), np.cumsum([1, 1, 2, 2]), axis=1)
    seen = np.split(rows.observation.numpy(), np.cumsum([3, 3, 2, 2]), axis=1)
    for agent in range(TEAM.agents):
        kind = 0 if agent < 2 else 1
        members = [stack.export()[0] for stack in engine.algorithm.ensemble.networks.stacks[kind :: len(TEAM.groups)]]
        x = np.concatenate([seen[agent], action[agent]], axis=1)
        values = [critic(flat, x, 8) for flat in members]
        np.testing.assert_allclose(diagnostics.member_std[agent], np.std(values, axis=0), rtol=1e-3, atol=1e-6)
    assert diagnostics.member_std.min() > 0


def engine_actions(engine, rows):
    return TeamActors(TEAM, 8, engine.algorithm.actors.export()).act(rows.observation.numpy())


def test_gradient_norms_are_of_each_agents_own_networks():
    """Norms of critic and actor gradients by agent are those of the networks' slices, and all agents differ."""
    engine = Engine(EiaSecConfig(hidden=8, batch=16), TEAM, 5)
    diagnostics = engine.update(batch(16), diagnostics=True)
    wanted = []
    for kind, group in enumerate(TEAM.groups):
        networks = engine.algorithm.critics.networks
        gradient = networks.parts(networks.flat.grad)[kind]
        wanted += [float(gradient[i].square().sum()) ** 0.5 for i in range(group.count)]
    np.testing.assert_allclose(diagnostics.critic_gradient_norm, wanted, rtol=1e-5)
    assert len({round(float(norm), 7) for norm in diagnostics.actor_gradient_norm}) == TEAM.agents
    assert diagnostics.actor_gradient_norm.min() > 0


@pytest.mark.parametrize("discount", [0.0, 0.5, 0.9])
def test_realised_returns_equal_a_plain_loop(discount):
    """They sum what followed up to the horizon; rows cut off before it do not count."""
    draw, replay, steps = np.random.default_rng(2), Replay(TEAM, 400), horizon(discount)
    flags = []
    for length, end in ((60, TERMINATED), (70, TRUNCATED), (5, TERMINATED), (80, 0)):
        flags += [TRANSITION] * (length - 1) + [TRANSITION | end, 0]
    count = len(flags)
    reward = draw.normal(size=(count, TEAM.agents)).astype(np.float32)
    replay.add(
        Rows(
            np.zeros((count, TEAM.observation_size), np.float32),
            np.zeros((count, TEAM.action_size), np.float32),
            reward,
            np.array(flags, np.uint8),
        ),
        0,
    )
    places = np.flatnonzero(np.array(flags) & TRANSITION)
    returns, counted = realised_returns(replay, places, discount)
    for place, found, counts in zip(places, returns, counted, strict=True):
        total, row = np.zeros(TEAM.agents), place
        for k in range(steps):
            total += discount**k * reward[row]
            row += 1
            if not flags[row] & TRANSITION:
                break
        assert counts == (k + 1 == steps or bool(flags[row - 1] & TERMINATED))
        if counts:
            np.testing.assert_allclose(found, total, atol=1e-5)
    assert counted.any()
    assert discount == 0.0 or not counted.all()


def test_the_newest_policies_rows_are_compared():
    """Of twelve rows with a return the three of the newest versions are chosen, and none without a return."""
    replay = Replay(TEAM, 100)
    for version, end in enumerate((TERMINATED, TERMINATED, TERMINATED, TRUNCATED)):
        flag = np.array([TRANSITION] * 3 + [TRANSITION | end, 0], np.uint8)
        rows = [np.zeros((5, width), np.float32) for width in (TEAM.observation_size, TEAM.action_size, TEAM.agents)]
        replay.add(Rows(*rows, flag), version)
    places = np.array([0, 1, 2, 3, 15, 16, 10, 11, 12, 13, 5, 6, 7, 8])
    _, chosen = newest_returns(replay, places, 0.99)
    assert chosen.tolist() == [6, 7, 8]
    assert newest_returns(replay, places[4:6], 0.99)[1].size == 0


def test_overestimation_is_q_less_what_was_realised():
    """With Q above the returns by one for every agent the figure is one, over the rows that count alone."""
    running = RunningDiagnostics(TEAM, "cpu")
    returns = torch.randn(6, TEAM.agents)
    counted = np.array([1, 1, 0, 1, 0, 1], np.bool_)
    target = torch.zeros(TEAM.agents, 6)
    error = (returns + 1.0).t().clone()
    error[:, ~torch.from_numpy(counted)] = 1e6
    diagnostics = Diagnostics(error, target, target, error + target)
    running.note(diagnostics)
    running.compare(diagnostics, returns, np.zeros(0, np.int64))
    assert running.comparisons == 0
    running.compare(diagnostics, returns, np.flatnonzero(counted))
    reported = running.by_agent()
    assert all(
        reported[f"overestimation/{name}"] == pytest.approx(1.0, abs=1e-5) for name in ("a-0", "a-1", "b-0", "b-2")
    )
    assert running.by_type()["realised_return/a"] == pytest.approx(float(returns[counted][:, :2].mean()), abs=1e-5)


def test_realised_returns_are_in_the_units_of_the_targets():
    """Half the reward scale and ten times the rewards give five times as large diagnostics."""
    reported = []
    for factor, scale in ((1.0, 1.0), (10.0, 0.5)):
        algorithm = EiaSecConfig(hidden=8, batch=64, reward_scale=scale)
        config = replace(preset("eia-sec"), algorithm=algorithm, replay=ReplayConfig(capacity=512, warmup_steps=0))
        trainer, random = OffPolicyTrainer(config, TEAM), np.random.default_rng(3)
        shapes = ((256, TEAM.observation_size), (256, TEAM.action_size), (256, TEAM.agents))
        seen, done, paid = (random.uniform(-0.9, 0.9, shape).astype(np.float32) for shape in shapes)
        flag = np.full(256, TRANSITION, np.uint8)
        flag[7::8] = 0
        flag[6::8] |= TERMINATED
        trainer.absorb(Chunk(Rows(seen, done, (paid + 1.0) * np.float32(factor), flag)))
        trainer.train(RETURN_PERIOD + 1)
        reported.append(trainer.diagnostics.by_type()["realised_return/a"])
    assert reported[1] == pytest.approx(5.0 * reported[0], rel=1e-3)
    assert reported[0] > 0.1


def test_diagnostics_that_an_algorithm_does_not_report_are_left_out():
    """Without norms and members there are none of them, and the rest is there for every type and agent."""
    running = RunningDiagnostics(TEAM, "cpu")
    running.note(Diagnostics(*torch.ones(4, TEAM.agents, 4)))
    names = {name.split("/")[0] for name in running.by_type()}
    assert names == {"critic_loss", "actor_objective", "target_mean", "critic_error", "q_mean"}
    assert len(running.by_agent()) == 5 * TEAM.agents


def events(folder):
    """Return the events of a folder's files: records of length, checksum, event, checksum."""
    found = []
    for path in sorted(folder.iterdir()):
        data = path.read_bytes()
        while data:
            (length,) = struct.unpack("<Q", data[:8])
            found.append(Event.FromString(data[12 : 12 + length]))
            data = data[16 + length :]
    return found


def test_scalars_are_in_the_event_file(tmp_path):
    """Nested maps become names with slashes; numbers come back with their step, and a second start adds a file."""
    for step in (7, 9):
        tensorboard = TensorBoardWriter(tmp_path)
        tensorboard.write(step, flattened({"reward": {"mean": 1.5 * step, "note": "text"}, "queue": 3}))
        tensorboard.close()
        assert tensorboard.failure == ""
    reported = [(e.step, {v.tag: v.simple_value for v in e.summary.value}) for e in events(tmp_path / FOLDER)]
    assert [entry for entry in reported if entry[1]] == [
        (7, {"reward/mean": 10.5, "queue": 3.0}),
        (9, {"reward/mean": 13.5, "queue": 3.0}),
    ]


def test_a_board_that_cannot_be_written_says_so(tmp_path):
    """A file in the folder's place is reported as a failure, and writing on is harmless; no folder is no failure."""
    (tmp_path / FOLDER).write_text("in the way")
    tensorboard = TensorBoardWriter(tmp_path)
    tensorboard.write(1, {"a": 1.0})
    assert "cannot be written: File exists; 1 are lost" in tensorboard.failure
    TensorBoardWriter(None).write(1, {"a": 1.0})
    assert TensorBoardWriter(None).failure == ""
