"""The small evaluations for those who watch a run."""

from types import SimpleNamespace

import numpy as np
import pytest

from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import EvaluationOrder, EvaluationResult, ProgressMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.elite import noise_free
from eia_sec.elite.noise_free import NoiseFreeReward
from tests.system.fleet import until

RUN = "noise-free"
NOW = ProgressMessage(1, 7, 0, 0, 0, 0, "training")


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test sets."""
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(noise_free, "monotonic", lambda: clock.now)
    return clock


@pytest.fixture
def lanes():
    """A worker's end of the control lane, and the coordinator's."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as worker, Bus.connect(endpoint, "control", wait=10.0) as bus:
        yield worker.serve(keys.EVALUATION.key(RUN, worker="w"), 4), bus


def watched(bus, config):
    return NoiseFreeReward(config, farm_team(config.farm), bus, RUN)


def asked(reward, served):
    """Return the worker's next order while the coordinator waits for its answer."""

    def order():
        reward.step()
        return served.poll()

    return until(order, "an order", 10.0)


def answered(reward, incoming, rewards):
    """Answer with these step rewards of every agent, [F, T], and wait until they are taken."""
    order, before = EvaluationOrder.decode(incoming.payload), reward.report()
    steps = np.repeat(np.float32(rewards)[:, :, None], 12, axis=2)
    incoming.reply(EvaluationResult(0, order.version, steps, np.full(len(rewards), steps.shape[1])).encode())

    def taken():
        reward.step()
        return reward.report() != before

    until(taken, "the reward", 10.0)


def test_a_worker_flies_the_first_evaluation_farms_once_a_minute(lanes, clock):
    """The mean return per agent is reported; the next order comes a minute later, for the same episodes."""
    served, bus = lanes
    reward = watched(bus, preset("quick"))
    reward.begin("w", NOW)
    reward.step()
    assert served.poll() is None
    assert reward.report()["noise_free"]["number"] == 0
    clock.now += 20.0
    reward.begin("w", NOW)
    first = asked(reward, served)
    order = EvaluationOrder.decode(first.payload)
    assert (order.version, order.farms) == (7, (1000, 1001, 1002, 1003))
    answered(reward, first, [[1.0, 2.0], [3.0, 4.0], [0.0, 0.0], [0.0, 2.0]])
    assert reward.report() == {"noise_free": {"reward": 3.0, "number": 1}}
    clock.now += 59.0
    reward.begin("w", NOW)
    reward.step()
    assert served.poll() is None
    clock.now += 2.0
    reward.begin("w", NOW)
    second = asked(reward, served)
    assert EvaluationOrder.decode(second.payload) == order
    answered(reward, second, [[1.0], [1.0], [1.0], [1.0]])
    assert reward.report() == {"noise_free": {"reward": 1.0, "number": 2}}


def test_what_takes_a_worker_long_comes_rarely(lanes, clock):
    """An evaluation of half a minute is followed by the next after ten."""
    served, bus = lanes
    reward = watched(bus, preset("quick"))
    clock.now += 20.0
    reward.begin("w", NOW)
    incoming = asked(reward, served)
    clock.now += 30.0
    answered(reward, incoming, [[1.0]] * 4)
    clock.now += 560.0
    reward.begin("w", NOW)
    reward.step()
    assert served.poll() is None
    clock.now += 20.0
    reward.begin("w", NOW)
    assert asked(reward, served)


def test_a_worker_that_refuses_changes_nothing(lanes, clock):
    """The view has no reward, and the worker is asked again."""
    served, bus = lanes
    reward = watched(bus, preset("quick"))
    for _ in range(2):
        clock.now += 61.0
        reward.begin("w", NOW)
        asked(reward, served).refuse("another order has arrived.")
        until(lambda: reward.step() or reward._asked is None, "the refusal", 10.0)
        assert reward.report()["noise_free"]["number"] == 0


def test_nothing_but_farms_is_flown(lanes, clock):
    """Another environment may be a robot."""
    served, bus = lanes
    config = with_values(preset("generic"), {"env.name": "mpe:simple_spread_v3"})
    reward = NoiseFreeReward(config, farm_team(preset("quick").farm), bus, RUN)
    clock.now += 1000.0
    reward.begin("w", NOW)
    reward.step()
    assert served.poll() is None
