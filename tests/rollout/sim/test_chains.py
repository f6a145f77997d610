"""Chains of relays to a base station: what counts over them, what relays are paid, and what both ends see."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import FailureConfig, FarmConfig, ObservationConfig, RelayConfig, RewardConfig, WorldConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_environment
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.sim.conditions.links import base_place, joined_relays
from eia_sec.rollout.sim.layout import make_layout
from tests.rollout.sim.properties.strategies import placed

RELAYED = REWARD_PARTS.index("relayed")
CHAIN = FarmConfig(
    world=WorldConfig(communication_uavs=2, monitoring_uavs=2, collection_uavs=1),
    relay=RelayConfig(require_link=True, link_range=150.0, base="south", hop_range=105.0),
    reward=RewardConfig(relayed=0.5),
    observation=ObservationConfig(mirrored=False, link=True),
)
PLACES = np.array([[200.0, 100.0], [200.0, 200.0], [210.0, 110.0], [190.0, 210.0], [200.0, 100.0]])
"""A relay 100 m north of the base station, another one 100 m on, a monitor over a plot near each, and the collector."""


def started(config, places=PLACES):
    """Return a batch whose UAVs stand at these places; all plots have VDF 3."""
    batch, levels = FarmBatch(config, 1), (np.zeros(config.world.sensors), np.full((20, 20), 3.0))
    with placed(make_layout(config, 0), places, levels):
        batch.reset(0, 0, 0)
    return batch


def waited(config, places=PLACES):
    """Return the same batch after a step in which nobody moves."""
    batch = started(config, places)
    batch.step(np.zeros((1, 2 * config.world.uavs), np.float32))
    return batch


def apart(places):
    """Return the places with the second relay 106 m from the first one."""
    moved = places.copy()
    moved[1, 1] += 6.0
    return moved


def views(batch, group):
    """Return what the UAVs of a type see, by name, [n_v] each."""
    spec = farm_environment(batch.config)
    rows = batch.team.split_observations(batch.observation[0])[group]
    return dict(zip(spec.tensor_names[spec.team.groups[group].name].observation, rows.T, strict=True))


def with_base(**changes):
    return replace(CHAIN, relay=replace(CHAIN.relay, **changes))


def test_images_count_over_two_hops():
    """Both monitors are within range of their relays, which form a chain."""
    batch = waited(CHAIN)
    assert batch.assignment[0].tolist()[:2] == [0, 1]
    assert (batch.utility[0, 2:4] > 0.0).all()


@pytest.mark.parametrize(
    ("changes", "counts"),
    [({"hop_range": 101.0}, [False, False]), ({"base": "north"}, [False, False]), ({"base": ""}, [True, True])],
)
def test_images_count_only_over_a_chain(changes, counts):
    """The first hop is 102.4 m long; the northern edge is too far; without a base station all count."""
    batch = waited(with_base(**changes))
    assert (batch.utility[0, 2:4] > 0.0).tolist() == counts


def test_a_gap_between_relays_cuts_off_the_far_one():
    """The second relay is 106 m from the first one, so only its own monitor has no link."""
    batch = waited(CHAIN, apart(PLACES))
    assert (batch.utility[0, 2:4] > 0.0).tolist() == [True, False]
    assert views(batch, 0)["joined"].tolist() == [1.0, 0.0]
    assert views(batch, 1)["relay_joined"].tolist() == [1.0, 0.0]
    assert views(batch, 1)["relay_up"].tolist() == [1.0, 1.0]


def test_the_failure_of_the_middle_relay_cuts_the_chain():
    """The other relay takes all UAVs over, but has no chain; without a base station it would serve them."""
    cut = replace(CHAIN, failures=FailureConfig(at="communication 0 at 1"))
    batch = waited(cut)
    assert (batch.assignment[0] == 1).all()
    assert not batch.utility[0].any()
    assert views(batch, 0)["joined_move_0_-1"].tolist() == [0.0, 0.0]
    alone = replace(cut, relay=replace(cut.relay, base=""))
    assert (waited(alone).utility[0, 2:4] > 0.0).all()


def test_a_relay_is_paid_for_what_others_relay_over_it():
    """Without the first relay nothing would count, without the second only its own monitor's images."""
    batch = waited(CHAIN)
    reward = CHAIN.reward
    lost = reward.monitoring * batch.utility[0, 2:4] + reward.monitoring_idle
    assert batch.utility[0, 4] == 0.0
    assert batch.parts[0, :2, RELAYED].tolist() == pytest.approx([0.5 * lost.sum(), 0.5 * lost[1]])


def test_relays_see_what_their_moves_do_to_the_chain():
    """Of the first relay's moves, one on cuts itself off and so both; one back leaves the other one behind."""
    seen = views(started(CHAIN), 0)
    assert seen["base_dx"].tolist() == [0.0, 0.0]
    assert seen["base_dy"].tolist() == pytest.approx([-0.25, -0.5])
    assert [seen[f"joined_move_0_{y}"][0] for y in (-1, 0, 1)] == [0.5, 1.0, 0.0]
    assert [seen[f"joined_move_0_{y}"][1] for y in (-1, 0, 1)] == [1.0, 1.0, 0.5]
    assert seen["joined_move_1_0"].tolist() == [1.0, 1.0]


def test_offsets_to_the_base_station_follow_the_own_axes():
    """A relay that is south-west of the middle of the field has both axes turned."""
    config = replace(CHAIN, observation=replace(CHAIN.observation, mirrored=True))
    seen = views(started(config, PLACES - [20.0, 0.0]), 0)
    assert (seen["base_dx"][0], seen["base_dy"][0]) == pytest.approx((-0.05, 0.25))


def test_a_base_station_is_seen_only_where_links_count():
    """Names of other farms stay as they are."""
    sizes = {
        (base, counts): [
            group.observation_size for group in farm_environment(with_base(base=base, require_link=counts)).team.groups
        ]
        for base in ("", "west")
        for counts in (False, True)
    }
    assert sizes["west", False] == sizes["", False] == sizes["", True]
    more = np.subtract(sizes["west", True], sizes["", True])
    assert more.tolist() == [12, 1, 1]


def test_places_of_base_stations():
    """Each stands in the middle of its edge."""
    places = {base: tuple(base_place(with_base(base=base)).tolist()) for base in ("north", "east", "south", "west")}
    assert places == {"north": (200.0, 400.0), "east": (400.0, 200.0), "south": (200.0, 0.0), "west": (0.0, 200.0)}


def test_chains_of_many_places_at_once():
    """Each row of places is judged by itself, and a relay that has failed passes nothing on."""
    places = np.stack([PLACES[:2], apart(PLACES[:2]), PLACES[[1, 0]]])
    assert joined_relays(CHAIN, places).tolist() == [[True, True], [True, False], [True, True]]
    gone = np.array([[True, False]] * 3)
    assert joined_relays(CHAIN, places, gone).tolist() == [[False, False], [False, False], [False, True]]


def test_impossible_chains_are_refused():
    """A range is positive."""
    with pytest.raises(ConfigError, match="hop_range"):
        RelayConfig(hop_range=0.0)
