"""A probe sees what the simulator does, and the simulator does not notice."""

from dataclasses import replace

import numpy as np

from eia_sec.common.config import ControlConfig
from eia_sec.common.protocol.view_checks import FRAMES, check_view
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.worker.farm_probe import FarmProbe
from eia_sec.rollout.worker.probe import HELD
from tests.deploy.monitor.web.stage import CONDITIONS, CONFIG, a_collector, some_actors

WORLD = CONFIG.farm.world


def flown(steps, opened=0, again=True, farm=CONFIG.farm):
    """Return the messages of a probe that was opened before a step of an episode, and the batch's own states."""
    batch = FarmBatch(farm, 2)
    probe = FarmProbe(batch, 1)
    probe.again = again
    for index in range(2):
        batch.reset(index, 3 + index, 7)
    states = []
    random = np.random.default_rng(0)
    for step in range(steps):
        if step == opened:
            probe.open(at_once=True)
        if batch.time[1] == WORLD.steps:
            for index in range(2):
                batch.reset(index, 3 + index, 8)
            probe.record()
        batch.step(random.uniform(-1, 1, (2, batch.team.environment_action_size)).astype(np.float32))
        probe.record()
        states.append((batch.position[1].copy(), batch.aoi[1].copy(), batch.vdf[1].copy(), batch.reward[1].copy()))
    return probe.take(5, 0.25, False), states


def test_frames_are_the_simulators_states():
    """Positions, AoI, VDF and rewards of every frame are those that the simulator had after that step."""
    messages, states = flown(20)
    assert [len(message.position) for message in messages] == [20]
    (message,) = messages
    check_view(message, CONFIG.farm, len(REWARD_PARTS))
    assert (message.farm, message.episode, message.first, message.skipped, message.noise_std) == (4, 7, 1, 5, 0.25)
    for i, (position, aoi, vdf, reward) in enumerate(states):
        np.testing.assert_allclose(message.position[i], position, atol=1e-4)
        np.testing.assert_allclose(message.aoi[i] / 255 * WORLD.aoi_max, aoi, atol=1e-9)
        np.testing.assert_allclose(message.vdf[i] / 255 * WORLD.vdf_max, vdf, atol=1e-9)
        np.testing.assert_allclose(message.level[i], [aoi.mean(), vdf.mean()], rtol=1e-6)
        by_type = [reward[:1].mean(), reward[1:3].mean(), reward[3:].mean()]
        np.testing.assert_allclose(message.parts[i].sum(axis=1), by_type, rtol=1e-4, atol=1e-5)


def test_a_frame_has_what_only_some_farms_have():
    """Failures, charge and the patches that the team knows are the simulator's; other farms send none of them."""
    farm = CONDITIONS.farm
    batch, random = FarmBatch(farm, 1), np.random.default_rng(0)
    probe = FarmProbe(batch, 0)
    batch.reset(0, 4, 7)
    probe.open(at_once=True)
    gone, charge, known = [], [], []
    for _ in range(WORLD.steps):
        batch.step(random.uniform(-1, 1, (1, batch.team.environment_action_size)).astype(np.float32))
        probe.record()
        for states, now in ((gone, batch.gone), (charge, batch.charge), (known, batch.patch_known)):
            states.append(now[0].copy())
    messages = probe.take(0, 0.0, False)
    for message in messages:
        check_view(message, farm, len(REWARD_PARTS))
    np.testing.assert_array_equal(np.concatenate([message.gone for message in messages]), gone)
    np.testing.assert_array_equal(np.concatenate([message.known for message in messages]), known)
    shares = np.concatenate([message.charge for message in messages]) / 255
    np.testing.assert_allclose(shares, np.array(charge) / farm.battery.capacity, atol=0.5 / 255)
    assert [int(np.sum(flags)) for flags in (gone[3], gone[4])] == [0, 1]
    assert 0.0 < shares[-1].min() < shares[0].min()
    assert 0 < np.sum(known) < np.size(known)
    (plain,), _ = flown(5)
    assert (plain.gone, plain.charge, plain.known) == (None, None, None)


def test_an_empty_battery_is_an_empty_bar():
    """The step that empties a battery takes more than is left; what is shown ends at 0."""
    batch = FarmBatch(replace(CONDITIONS.farm, battery=replace(CONDITIONS.farm.battery, capacity=1.0)), 1)
    probe = FarmProbe(batch, 0)
    batch.reset(0, 4, 7)
    probe.open(at_once=True)
    batch.step(np.ones((1, batch.team.environment_action_size), np.float32))
    probe.record()
    (message,) = probe.take(0, 0.0, False)
    assert batch.charge.max() < 0.0
    assert not message.charge.any()


def test_how_uavs_are_controlled_changes_no_frame():
    """A farm whose actors choose moves and headings takes velocities like any other, and is shown in the same way."""
    choices = ControlConfig(communication="headings", monitoring="moves", collection="moves")
    (shown,), _ = flown(20, farm=replace(CONFIG.farm, control=choices))
    (wanted,), _ = flown(20)
    assert shown.encode() == wanted.encode()


def test_a_message_holds_consecutive_steps_of_one_episode():
    """An episode's end begins another message, the next one with the state after the reset; none is too long."""
    messages, _ = flown(60)
    assert [(message.episode, message.first, len(message.position)) for message in messages] == [
        (7, 1, FRAMES),
        (7, 1 + FRAMES, WORLD.steps - FRAMES),
        (8, 0, 21),
    ]


def test_a_probe_that_does_not_go_on_closes_with_the_episode():
    """Without `again` nothing is kept behind an episode's last step."""
    messages, _ = flown(60, opened=10, again=False)
    assert [message.first for message in messages] == [11]
    assert messages[0].first + len(messages[0].position) - 1 == WORLD.steps


def test_a_probe_that_nobody_empties_closes():
    """A probe holds HELD frames and no more."""
    messages, _ = flown(HELD + 100)
    assert sum(len(message.position) for message in messages) == HELD


def test_what_is_flown_does_not_depend_on_who_looks():
    """The rows of a collector with a probe are bit-equal to those of one without."""
    actors, chunks = some_actors(), []
    for watched in (False, True):
        collector = a_collector()
        if watched:
            probe = FarmProbe(collector.environments, 0)
            probe.open(at_once=True)
            collector.probe = probe
        chunks.append([collector.collect(actors, 0.3, False).rows for _ in range(6)])
    assert sum(len(message.position) for message in probe.take(0, 0.3, False)) == 61
    for bare, seen in zip(*chunks, strict=True):
        for name, array in vars(bare).items():
            np.testing.assert_array_equal(getattr(seen, name), array)
