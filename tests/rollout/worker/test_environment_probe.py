"""A probe sees what an environment does and draws, bounded in bytes and in time."""

import io
import sys
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from eia_sec.common.config import EnvConfig
from eia_sec.common.protocol.messages import StepsMessage
from eia_sec.common.protocol.view_checks import FRAMES, MOST_SIDE, check_steps
from eia_sec.rollout.envs import guard
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch
from eia_sec.rollout.worker import environment_probe
from eia_sec.rollout.worker.environment_probe import LONGEST, EnvironmentProbe


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "envs"))
    yield
    for name in ("toy_env", "toy_pictures"):
        sys.modules.pop(name, None)
    guard._theirs.clear()


def run(steps, pace=1e-6, silence="", **arguments):
    """Return what a probe has of so many steps, the states themselves, and the probe."""
    text = "{" + ", ".join(f'"{key}": {value}' for key, value in arguments.items()) + "}"
    random, states = np.random.default_rng(0), []
    with closing(PettingZooBatch(EnvConfig("toy_pictures:Drawn", text), 2)) as batch:
        probe = EnvironmentProbe(batch, 0, pace, silence)
        probe.open(at_once=True)
        for _ in range(steps):
            for index in np.flatnonzero(batch.ended | (batch.time < 0)):
                batch.reset(int(index), 3, 7)
                if index == 0:
                    probe.record()
            batch.step(random.uniform(-1, 1, (2, batch.team.action_size)).astype(np.float32))
            probe.record()
            states.append((batch.reward[0].copy(), batch.action[0].copy(), batch.observation[0].copy(), batch.alive(0)))
        messages = [StepsMessage.decode(message.encode()) for message in probe.take(5, 0.25, False)]
        for message in messages:
            check_steps(message, batch.team)
        return messages, states, probe


def pictures(message):
    """Return each frame's picture, or None."""
    edges = [0, *message.ends.tolist()]
    files = [message.pictures[a:b].tobytes() for a, b in pairwise(edges)]
    return [np.array(Image.open(io.BytesIO(file))) if file else None for file in files]


def test_frames_are_the_environments_states():
    """Rewards, actions, observations and pictures of every frame are those after that step."""
    (message,), states, probe = run(4)
    assert (message.scenario, message.episode, message.first, message.skipped) == (3, 7, 0, 5)
    assert message.frames == 5
    assert not message.reward[0].any()
    assert not message.action[0].any()
    for i, (reward, action, observation, alive) in enumerate(states, 1):
        np.testing.assert_array_equal(message.reward[i], reward)
        np.testing.assert_array_equal(message.action[i], action)
        np.testing.assert_array_equal(message.alive[i], alive)
        first = observation[:2]
        np.testing.assert_allclose(message.seen[i, 0], [first.min(), first.mean(), first.max()])
    assert [int(picture.max()) for picture in pictures(message)] == [0, 1, 2, 3, 4]
    assert message.alive[-1].tolist() == [0, 0, 1]  # the runners have left after 3 steps
    assert (message.silence, probe.pictures) == ("", 5)


def test_large_pictures_are_made_smaller():
    """No side has more than MOST_SIDE pixels, and the shape stays."""
    (message,), _, _ = run(1, height=300, width=1200)
    assert pictures(message)[0].shape == (MOST_SIDE // 4, MOST_SIDE, 3)


def test_slow_pictures_take_a_share_of_the_time(monkeypatch):
    """What takes 20 ms is drawn so rarely that at 25 steps a second it takes SHARE of the time."""
    monkeypatch.setattr(environment_probe, "SHARE", 0.1)
    messages, _, probe = run(40, pace=25.0, seconds=0.02)
    drawn = [i for message in messages for i, picture in enumerate(pictures(message)) if picture is not None]
    total = sum(message.frames for message in messages)
    assert 1 <= len(drawn) == probe.pictures <= total * 0.1 / (0.02 * 25) + 1


def test_what_a_picture_costs_is_the_mean_without_the_first(monkeypatch):
    """The first may load a library; where pictures take 40 and 0 ms in turns, about every fifth step is drawn."""
    clock = SimpleNamespace(now=0.0, calls=0)

    def passing():
        clock.calls += 1
        if clock.calls % 2:  # at the end of a picture; that of the first is not asked for
            clock.now += 0.04 * (clock.calls // 2 % 2)
        return clock.now

    monkeypatch.setattr(environment_probe, "time", SimpleNamespace(perf_counter=passing))
    messages, _, _ = run(40, pace=25.0)
    frames = [picture is not None for message in messages for picture in pictures(message)]
    drawn = np.flatnonzero(frames)
    assert drawn[:2].tolist() == [0, 1]
    assert np.diff(drawn)[2:].min() >= 4


def test_pictures_held_are_bounded_in_bytes(monkeypatch):
    """What does not fit any more is shown without pictures until they are taken."""
    monkeypatch.setattr(environment_probe, "HELD_BYTES", environment_probe.MOST_PICTURE)
    messages, _, probe = run(30)
    assert probe.pictures == 1
    assert sum(message.frames for message in messages) == 36


def test_a_stretch_is_bounded_and_goes_on_in_the_same_episode():
    """After LONGEST frames the probe closes; opened again in the middle of that episode it continues there."""
    with closing(PettingZooBatch(EnvConfig("toy_pictures:Drawn", '{"leave": 9, "stay": 2000}'), 1)) as batch:
        probe = EnvironmentProbe(batch, 0, 25.0, "nothing is drawn")
        batch.reset(0, 3, 7)
        probe.open(at_once=True)
        for _ in range(LONGEST + 20):
            batch.step(np.zeros((1, batch.team.action_size), np.float32))
            probe.record()
        assert not probe.is_open
        messages = probe.take(0, 0.0, False)
        assert sum(message.frames for message in messages) == LONGEST
        assert max(message.frames for message in messages) == FRAMES
        assert {message.silence for message in messages} == {"nothing is drawn"}
        probe.open(at_once=False)
        batch.step(np.zeros((1, batch.team.action_size), np.float32))
        probe.record()
        (message,) = probe.take(0, 0.0, False)
        assert message.first == LONGEST + 21
