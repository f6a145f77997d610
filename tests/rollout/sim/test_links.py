"""Links that count: what relays are paid for, and what both ends see."""

import copy
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from eia_sec.common.config import FarmConfig, RelayConfig
from eia_sec.common.config.farm.observation import ObservationConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_environment
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.reference.farm import ReferenceFarm
from tests.rollout.sim.test_reference import SMALL, actions

RELAYED, UTILITY, IDLE = (REWARD_PARTS.index(name) for name in ("relayed", "utility", "idle"))
BASE = FarmConfig(world=SMALL)
LINKED = replace(
    BASE,
    relay=RelayConfig(require_link=True, link_range=45.0),
    reward=replace(BASE.reward, relayed=0.5),
    observation=ObservationConfig(link=True),
)


def without_links(farm, relay):
    """Let a reference farm do its next step as if no UAV had a link to this relay."""
    assign = farm._assign

    def cut(chosen=None):
        assign(chosen)
        farm.linked = farm.linked & (farm.assignment != relay)

    return patch.object(farm, "_assign", cut)


def test_relays_are_paid_what_the_team_would_lose_without_their_links():
    """Each step is simulated again without the links of one relay, all else equal: the team loses just that."""
    farm = ReferenceFarm(LINKED, make_layout(LINKED, 3), 17)
    paid = np.zeros(SMALL.communication_uavs)
    for action in actions(LINKED, 60, 5):
        before = copy.deepcopy(farm)
        farm.step(action)
        earned = farm.parts[:, [UTILITY, IDLE]].sum()
        for relay in range(SMALL.communication_uavs):
            other = copy.deepcopy(before)
            with without_links(other, relay):
                other.step(action)
            lost = earned - other.parts[:, [UTILITY, IDLE]].sum()
            assert farm.parts[relay, RELAYED] == pytest.approx(0.5 * lost, abs=1e-9)
        paid += farm.parts[: SMALL.communication_uavs, RELAYED]
    assert (paid > 0.0).all()


def test_a_flight_with_links_equals_the_reference():
    """Rewards, their parts and observations, with links that come and go."""
    batch = FarmBatch(LINKED, 1)
    batch.reset(0, 3, 17)
    farm, up = ReferenceFarm(LINKED, make_layout(LINKED, 3), 17), []
    for action in actions(LINKED, 80, 5):
        batch.step(action[None])
        farm.step(action)
        np.testing.assert_allclose(batch.parts[0], farm.parts, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(batch.observation[0], farm.observation, rtol=1e-6, atol=1e-6)
        up += farm.linked.tolist()
    assert 0.1 < np.mean(up) < 0.9


def test_nothing_is_paid_where_links_do_not_count():
    """Without `require_link` nothing is lost with a link, whatever the weight."""
    config = replace(LINKED, relay=RelayConfig(require_link=False))
    batch = FarmBatch(config, 1)
    batch.reset(0, 3, 17)
    for action in actions(config, 20, 5):
        batch.step(action[None])
        assert not batch.parts[0, :, RELAYED].any()


def test_both_ends_see_the_same_link():
    """What a UAV sees of its link is what its relay sees of it, from the other end."""
    environment = farm_environment(LINKED)
    batch = FarmBatch(LINKED, 1)
    batch.reset(0, 3, 17)
    for action in actions(LINKED, 10, 5):
        batch.step(action[None])
        rows = batch.team.split_observations(batch.observation)
        named = [
            [dict(zip(environment.tensor_names[group.name].observation, row, strict=True)) for row in part[0]]
            for group, part in zip(batch.team.groups, rows, strict=True)
        ]
        served = [uav for part in named[1:] for uav in part]
        for relay, seen in enumerate(named[0]):
            own = [served[k] for k in np.flatnonzero(batch.assignment[0] == relay)]
            for place, uav in enumerate(own):
                assert seen[f"served_{place}_slack"] == pytest.approx(uav["relay_slack"], abs=1e-6)
                assert abs(seen[f"served_{place}_dx"]) == pytest.approx(abs(uav["relay_dx"]), abs=1e-6)
            share = np.mean([uav["relay_up"] for uav in own]) if own else 1.0
            assert seen["links_up_move_0_0"] == pytest.approx(share)
            assert seen["links_up_move_0_0"] == 1.0 or seen["least_slack_move_0_0"] < 0.0


def test_the_switch_is_off_in_every_preset_of_the_paper():
    """Links are seen and paid for where a preset says so."""
    for name in ("instant", "quick", "eia-sec", "study", "paper"):
        assert not preset(name).farm.observation.link
        assert preset(name).farm.reward.relayed == 0.0
