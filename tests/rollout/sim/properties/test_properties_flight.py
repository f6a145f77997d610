"""Every step of any flight, rebuilt in NumPy: motion, energy, relays, the reward's parts, and what may be seen."""

import numpy as np
import pytest
from hypothesis import given
from scipy.optimize import linear_sum_assignment

from eia_sec.rollout.envs.spaces import row_box
from eia_sec.rollout.sim.batch import REWARD_PARTS
from eia_sec.rollout.sim.reference.farm import NEGLIGIBLE, free_space_loss
from eia_sec.rollout.sim.reference.power import flight_power, other_power
from tests.rollout.sim.course import Course, fly
from tests.rollout.sim.properties.strategies import dose, flights, instant_farms

EXACT = {"rtol": 1e-9, "atol": 1e-9}


def part(course: Course, name: str) -> np.ndarray:
    """Return a part of the reward, [T, n]."""
    return course.parts[:, :, REWARD_PARTS.index(name)]


def by_kind(course: Course, communication: float, monitoring: float, collection: float) -> np.ndarray:
    """Return one number for each UAV by its type, [n]."""
    return np.array([communication, monitoring, collection])[course.kinds]


@dose(12)
@given(flights(instant_farms()))
def test_uavs_go_where_they_are_sent_and_stay_in_the_field(flight):
    """The position is the commanded one, clipped to the field, and ACT is paid for exactly where it was clipped."""
    course = fly(flight)
    np.testing.assert_allclose(course.position[1:], np.clip(course.wanted, 0.0, flight.size), **EXACT)
    assert ((course.position >= 0.0) & (course.position <= flight.size)).all()
    clipped = ((course.wanted < 0.0) | (course.wanted > flight.size)).any(axis=2)
    weight = flight.config.reward.boundary * flight.config.world.step_seconds
    np.testing.assert_allclose(part(course, "boundary"), -weight * clipped, **EXACT)
    assert course.summary.metrics["boundary"] == clipped.sum()


@dose(12)
@given(flights(instant_farms()))
def test_energy_is_the_power_at_the_commanded_speed(flight):
    """More than 0, and the flight power of the chosen model plus everything else that the type of UAV needs."""
    course, energy = fly(flight), flight.config.energy
    speed = np.linalg.norm(course.velocity, axis=2)
    power = np.vectorize(lambda v: flight_power(energy, v), otypes=[float])(speed)
    power += by_kind(course, *(other_power(energy, kind) for kind in range(3)))
    assert (course.energy > 0.0).all()
    near_hover = np.abs(speed - energy.hover_speed) < 1e-9
    expected = np.where(near_hover, course.energy, power * flight.config.world.step_seconds)
    np.testing.assert_allclose(course.energy, expected, **EXACT)
    np.testing.assert_allclose(part(course, "energy"), -flight.config.reward.energy * course.energy, **EXACT)
    assert course.summary.metrics["energy_j"] == pytest.approx(course.energy.sum(), rel=1e-9)


def costs(course: Course, step: int) -> np.ndarray:
    """Return the assignment's costs, [n_m + n_d, n_c] (W3)."""
    relay, world, place = course.flight.config.relay, course.flight.config.world, course.place()[step]
    first, diagonal = world.communication_uavs, np.hypot(world.field_x, world.field_y)
    distance = np.linalg.norm(place[first:, None] - place[None, :first], axis=2)
    radio = course.flight.config.radio
    loss = free_space_loss(radio, np.maximum(distance, 1.0)) / free_space_loss(radio, diagonal)
    return relay.cost_distance * distance / diagonal + relay.cost_link * loss


@dose(12)
@given(flights())
def test_relays_serve_everyone_at_the_least_cost_within_their_capacity(flight):
    """Everyone has a relay, none has more than its capacity, and the costs sum to scipy's optimum."""
    course, relays = fly(flight), flight.config.world.communication_uavs
    capacity = flight.config.relay.capacity_for(flight.config.world)
    assert ((course.assignment >= 0) & (course.assignment < relays)).all()
    for step, chosen in enumerate(course.assignment):
        assert np.bincount(chosen, minlength=relays).max() <= capacity
        cost = costs(course, step)
        rows, columns = linear_sum_assignment(np.repeat(cost, capacity, axis=1))
        least = cost[rows, columns // capacity].sum()
        np.testing.assert_allclose(cost[np.arange(len(chosen)), chosen].sum(), least, **EXACT)


def service(course: Course, step: int) -> np.ndarray:
    """Return D_c of every relay, [n_c] m, from where everybody is and whom it serves."""
    weight, place, chosen = course.flight.config.relay, course.place()[step], course.assignment[step]
    relays = place[course.kinds == 0]
    values = weight.weight_relays * np.linalg.norm(relays - relays.mean(axis=0), axis=1)
    for relay in np.unique(chosen):
        served = place[course.kinds > 0][chosen == relay]
        values[relay] += weight.weight_centroid * np.linalg.norm(served.mean(axis=0) - relays[relay])
        values[relay] += weight.weight_farthest * np.linalg.norm(served - relays[relay], axis=1).max()
    return values


@dose(12)
@given(flights())
def test_relays_are_paid_for_the_change_of_their_service(flight):
    """D_c is that of the positions and the assignment, and only relays are paid for its change."""
    course, weight = fly(flight), flight.config.reward
    np.testing.assert_allclose(course.service, [service(course, step) for step in range(course.steps + 1)], **EXACT)
    scale = -weight.positioning * flight.config.world.step_seconds
    relays = course.kinds == 0
    np.testing.assert_allclose(part(course, "positioning")[:, relays], scale * np.diff(course.service, axis=0), **EXACT)
    assert not part(course, "positioning")[:, ~relays].any()


@dose(12)
@given(flights())
def test_risk_is_that_of_the_closest_pair(flight):
    """What the distance to a closest UAV falls by, under d_safety; of several as close, any may count."""
    course, weight, world = fly(flight), flight.config.reward, flight.config.world
    place = course.place()
    apart = np.linalg.norm(place[:, :, None] - place[:, None], axis=3)
    now, before = apart[1:], apart[:-1]
    strangers = course.kinds[:, None] != course.kinds
    now = np.where(strangers | np.eye(len(strangers), dtype=bool), np.inf, now)
    least = now.min(axis=2, keepdims=True)
    closest = np.isfinite(now) & (now <= least + 1e-9)
    risk = np.maximum(0.0, np.where(closest, before - now, 0.0))
    expected = -weight.collision_risk * world.step_seconds * risk
    risk = part(course, "risk")[:, :, None]
    near, far = (least[..., 0] < world.safety_distance + margin for margin in (-1e-9, 1e-9))
    assert (closest & (np.abs(risk - expected) < 1e-7)).any(axis=2)[near].all()
    assert not risk[~far].any()


@dose(12)
@given(flights())
def test_the_task_is_paid_by_what_was_credited_and_the_way_flown(flight):
    """Utility by the units credited, idle exactly where there are none, motivation where v . D > 0; none for relays."""
    course, weight, seconds = fly(flight), flight.config.reward, flight.config.world.step_seconds
    idle = by_kind(course, 0.0, weight.monitoring_idle, weight.collection_idle)
    utility = by_kind(course, 0.0, weight.monitoring, weight.collection)
    motivation = by_kind(course, 0.0, weight.monitoring_motivation, weight.collection_motivation)
    along = (course.velocity * course.direction[:-1]).sum(axis=2)
    scale = np.linalg.norm(course.velocity, axis=2)
    judged = (np.abs(along) > 1e-12 * scale) | (along == 0.0)
    expected = motivation * (along > 0.0) * seconds
    np.testing.assert_allclose(part(course, "utility"), utility * course.utility * seconds, **EXACT)
    np.testing.assert_allclose(part(course, "idle"), -idle * (course.utility < NEGLIGIBLE) * seconds, **EXACT)
    np.testing.assert_allclose(part(course, "motivation")[judged], expected[judged], **EXACT)


@dose(12)
@given(flights())
def test_the_reward_is_the_sum_of_its_parts(flight):
    """Bit by bit: the float64 parts are added in their order, and the sum is rounded once to float32."""
    course = fly(flight)
    total = np.zeros(course.reward.shape)
    for index in range(len(REWARD_PARTS)):
        total = total + course.parts[:, :, index]
    np.testing.assert_array_equal(course.reward, total.astype(np.float32))
    np.testing.assert_allclose(course.summary.reward, course.reward.astype(np.float64).sum(axis=0), **EXACT)


@dose(12)
@given(flights())
def test_the_summary_is_that_of_the_course(flight):
    """Mean AoI and VDF over the steps, and UAVs of one plane closer than the collision distance."""
    course = fly(flight)
    apart = np.linalg.norm(course.position[1:, :, None] - course.position[1:, None], axis=3)
    others = (course.kinds[:, None] == course.kinds) & ~np.eye(len(course.kinds), dtype=bool)
    least = np.where(others, apart, np.inf).min(axis=2)
    fewest, most = ((least < flight.config.world.collision_distance + margin).sum() for margin in (-1e-9, 1e-9))
    assert fewest <= course.summary.metrics["collisions"] <= most
    assert course.summary.metrics["aoi"] == pytest.approx(course.aoi[1:].mean(), abs=1e-9)
    assert course.summary.metrics["vdf"] == pytest.approx(course.vdf[1:].mean(), abs=1e-9)
    assert (course.summary.farm, course.summary.episode) == (flight.farm, flight.episode)
    assert course.summary.steps == course.steps


@dose(12)
@given(flights())
def test_observations_are_finite_and_bounded(flight):
    """Every number lies within the bounds of its space, and directions have length 1 or 0."""
    course, box = fly(flight), row_box(flight.config)
    assert np.isfinite(course.observation).all()
    assert ((course.observation >= box.low) & (course.observation <= box.high)).all()
    length = np.linalg.norm(course.direction, axis=2)
    assert ((length == 0.0) | (np.abs(length - 1.0) < 1e-12)).all()
