"""UAVs that fail: the compiled farm against the reference, and what a UAV that is gone never does."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.config import FailureConfig, FarmConfig, RelayConfig
from eia_sec.common.config.farm.failures import KINDS
from eia_sec.common.farm import farm_environment
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.reference.farm import ReferenceFarm
from tests.rollout.sim.course import STARTING, STEPPING, begin
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights, placed, worlds
from tests.rollout.sim.properties.test_properties_added import everything
from tests.rollout.sim.properties.test_properties_batch import assert_same, perform
from tests.rollout.sim.properties.test_properties_hindsight import countable, flown
from tests.rollout.sim.properties.test_properties_reference import flown_beside, reference_of

SMALL = worlds(st.one_of(st.integers(1, 3), st.integers(1, 8)), 80)


@st.composite
def failing(draw: st.DrawFn, configs: st.SearchStrategy[FarmConfig]) -> FarmConfig:
    """Draw a farm in which UAVs fail at random, at given steps, or both; sometimes all of a type at once."""
    config = draw(configs)
    world, given_at = config.world, []
    for kind, count in enumerate(world.counts):
        ranks = draw(st.sampled_from(["none", "some", "some", "all"]))
        chosen = {"none": set(), "all": set(range(count))}.get(ranks) if ranks != "some" else None
        if chosen is None:
            chosen = draw(st.sets(st.integers(0, count - 1), max_size=3))
        step = draw(st.integers(1, world.steps))
        given_at += [f"{KINDS[kind]} {rank} at {step}" for rank in sorted(chosen)]
    hours = world.steps * world.step_seconds / 3600.0
    rate = draw(st.sampled_from([0.0, 0.0, 0.5, 2.0])) / hours
    return replace(config, failures=FailureConfig(rate, ", ".join(given_at), draw(st.sampled_from([0.0, 0.0, 0.5]))))


FARMS = failing(farm_configs(SMALL))


def assert_least_cost(batch: FarmBatch, reference: ReferenceFarm) -> None:
    """Each living UAV has a living relay, if there is any, no relay has too many, and the sum of costs is least."""
    chosen, relays = batch.assignment[0], reference.living(0)
    served = np.flatnonzero(~reference.gone[batch.config.world.communication_uavs :])
    np.testing.assert_array_equal(chosen >= 0, np.isin(np.arange(len(chosen)), served) & (len(relays) > 0))
    if len(relays):
        assert np.isin(chosen[served], relays).all()
        most = max(batch.config.relay.capacity_for(batch.config.world), -(-len(served) // len(relays)))
        assert np.bincount(chosen[served], minlength=1).max() <= most
        cost = reference.assignment_costs()[served, chosen[served]].sum()
        np.testing.assert_allclose(cost, reference.assignment_cost, rtol=1e-9, atol=1e-9)


@dose(20)
@given(flights(FARMS), st.booleans())
def test_any_flight_with_failures_equals_the_reference(flight: Flight, all_on: bool):
    """Every quantity after every step, within the bounds of the observation."""
    if all_on:
        flight = replace(flight, config=everything(flight.config))
    batch = begin(flight)
    reference = reference_of(flight, batch)
    for _ in flown_beside(flight, batch, reference):
        assert_least_cost(batch, reference)
        np.testing.assert_array_equal(batch.gone[0], reference.gone)
        np.testing.assert_allclose(batch.link_quality[0], reference.link_quality, rtol=1e-9, atol=1e-9)


@dose(20)
@given(flights(FARMS), st.integers(0, 2**32))
def test_a_uav_that_is_gone_does_nothing(flight: Flight, seed: int):
    """It stays where it failed, everything of it is exactly 0, and its actions change nothing, bit by bit."""
    batch, other = begin(flight), begin(flight)
    random = np.random.default_rng(seed)
    sizes = np.repeat([g.observation_size for g in batch.team.groups], [g.count for g in batch.team.groups])
    gone = batch.gone[0].copy()
    assert not gone.any()
    for action in flight.actions():
        before, changed = batch.position[0].copy(), action.copy()
        batch.step(action[None])
        now = batch.gone[0]
        changed[np.repeat(now, 2)] = random.uniform(-1.0, 1.0, 2 * now.sum())
        other.step(changed[None])
        assert (now >= gone).all()
        gone = now.copy()
        np.testing.assert_array_equal(batch.position[0, gone], before[gone])
        for name in ("reward", "parts", "energy", "utility", "direction"):
            assert not getattr(batch, name)[0, gone].any(), name
        assert not batch.service[0, gone[: batch.service.shape[1]]].any()
        assert not batch.observation[0, np.repeat(gone, sizes)].any()
        for name in (*STARTING, *STEPPING, "link_quality"):
            np.testing.assert_array_equal(getattr(batch, name), getattr(other, name), err_msg=name)
    assert batch.summary(0).metrics.get("failed", 0.0) == gone.sum()


@dose(15)
@given(flights(farm_configs(SMALL)), st.integers(0, 2**32))
def test_a_farm_without_a_uav_equals_one_whose_uav_fails_at_once(flight: Flight, seed: int):
    """Bit by bit: the others fly, serve and earn as if it had never been; D_c still knows it at the start."""
    world, random = flight.config.world, np.random.default_rng(seed)
    kinds = [kind for kind, count in enumerate(world.counts) if count > 1]
    if not kinds:
        return
    kind = int(random.choice(kinds))
    rank = int(random.integers(world.counts[kind]))
    u, served = sum(world.counts[:kind]) + rank, world.monitoring_uavs + world.collection_uavs
    reduced = replace(world, **{f"{KINDS[kind]}_uavs": world.counts[kind] - 1})
    whole = replace(flight.config, relay=replace(RelayConfig(), capacity=served))
    failing_farm = replace(whole, failures=FailureConfig(at=f"{KINDS[kind]} {rank} at 1"))
    full, less = FarmBatch(failing_farm, 1), FarmBatch(replace(whole, world=reduced), 1)
    kept, positions = np.arange(world.uavs) != u, flight.positions()
    for batch, places in ((full, positions), (less, positions[kept])):
        with placed(flight.layout(), places):
            batch.reset(0, flight.farm, flight.episode)
    if flight.starts != "seeded":
        return  # equal costs may be settled either way
    for step, action in enumerate(flight.actions()):
        full.step(action[None])
        less.step(np.ascontiguousarray(action[np.repeat(kept, 2)][None]))
        for name in ("position", "direction", "energy", "utility"):
            np.testing.assert_array_equal(getattr(full, name)[0, kept], getattr(less, name)[0], err_msg=name)
        np.testing.assert_array_equal(full.aoi, less.aoi)
        np.testing.assert_array_equal(full.vdf, less.vdf)
        first = 1 if step == 0 else 0  # in the first step D_c loses what the UAV added to it
        np.testing.assert_array_equal(full.parts[0, kept][:, first:], less.parts[0][:, first:])


@dose(10)
@given(flights(farm_configs(SMALL)))
def test_failures_that_do_not_happen_change_nothing(flight: Flight):
    """With a rate so low that nobody fails, every array is bit for bit that of a farm without the switch."""
    rare = replace(flight.config, failures=FailureConfig(per_hour=1e-12))
    plain, switched = begin(flight), begin(replace(flight, config=rare))
    names = [
        [spec.tensor_names[g.name].observation for g in spec.team.groups for _ in range(g.count)]
        for spec in (farm_environment(flight.config), farm_environment(rare))
    ]
    keep = np.concatenate([np.isin(mine, usual) for usual, mine in zip(*names, strict=True)])
    for action in flight.actions():
        plain.step(action[None])
        switched.step(action[None])
        for name in (*STARTING, *STEPPING, "link_quality"):
            ours, theirs = getattr(plain, name), getattr(switched, name)
            np.testing.assert_array_equal(ours, theirs[:, keep] if name == "observation" else theirs, err_msg=name)
        assert (switched.observation[0, ~keep] == 1.0).all()


@dose(7)
@given(st.data())
def test_a_batch_with_failures_equals_its_environments_alone(data: st.DataObject):
    """Bit by bit after every step; each episode has failures of its own."""
    config = data.draw(FARMS)
    company = data.draw(st.lists(st.lists(flights(st.just(config)), min_size=1, max_size=2), min_size=2, max_size=4))
    for tracks in perform(company, 25):
        for flight, track in tracks:
            assert_same(perform([[flight]], len(track) - 1)[0], [(flight, track)])


@dose(12)
@given(flights(FARMS.map(countable)))
def test_hindsight_knows_that_the_gone_make_no_visits(flight: Flight):
    """Corrections equal those of counters that go on, and there is none for a step in which the UAV was gone."""
    batch, logged, _, utility = flown(flight)
    np.testing.assert_array_equal(batch.hindsight[0], logged.corrections())
    absent = logged.failure <= np.arange(1, flight.config.world.steps + 1)[:, None]
    assert not batch.hindsight[0][absent].any()
    assert not utility[absent].any()


def test_the_drawn_farms_lose_uavs_of_every_type():
    """Among the default dose are failures of each type, whole types that are gone, and farms without any relay."""
    seen = []

    @dose(40)
    @given(flights(FARMS))
    def collect(flight):
        batch = begin(flight)
        for action in flight.actions():
            batch.step(action[None])
        gone = batch.team.agent_slices()
        seen.append([[batch.gone[0, part].any(), batch.gone[0, part].all()] for part in gone])

    collect()
    assert np.mean(seen, axis=0).min() > 0.1
