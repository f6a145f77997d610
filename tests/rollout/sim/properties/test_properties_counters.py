"""AoI and VDF on any farm: their range, when they rise and fall, who is credited, and the largest sum."""

from typing import NamedTuple

import numpy as np
from hypothesis import given

from eia_sec.rollout.sim.reference.farm import NEGLIGIBLE, noise_mw, packet_loss, received_mw
from tests.rollout.sim.course import Course, fly
from tests.rollout.sim.properties.strategies import dose, flights

CLOSE = 1e-9
"""Two distances closer than this, m, may rank either way: where a plot's centre lies depends on rounding."""


class Tally(NamedTuple):
    """One kind of counter over T steps; I counters, U UAVs that serve them.

    Attributes:
        before: [T, I] value before the step.
        after: [T, I] value after it.
        due: [T, I] whether the counter was due to rise.
        most: the cap.
        possible: [T, U, I] whether the UAV could serve the counter.
        certain: [T, U, I] whether it must have served it.
        credit: [T, U] units credited.
    """

    before: np.ndarray
    after: np.ndarray
    due: np.ndarray
    most: int
    possible: np.ndarray
    certain: np.ndarray
    credit: np.ndarray

    @property
    def raised(self) -> np.ndarray:
        """[T, I] the counter after the step if nobody serves it."""
        return np.minimum(self.before + self.due, self.most)

    @property
    def share(self) -> np.ndarray:
        """[T, I] which share of the counter was served."""
        return 1.0 - np.divide(self.after, self.raised, out=np.ones_like(self.after), where=self.raised > 0)


def nearest(course: Course, kind: int, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which UAVs of a kind may be and which surely are the closest to the places [I, 2], [T, U, I] each."""
    apart = np.linalg.norm(course.position[1:, course.kinds == kind, None] - places, axis=3)
    possible = apart <= apart.min(axis=1, keepdims=True) + CLOSE
    return possible, possible & (possible.sum(axis=1, keepdims=True) == 1)


def linked(course: Course, kind: int) -> tuple[np.ndarray, np.ndarray]:
    """Return whose work may count and whose surely does, [T, U, 1] each (W4)."""
    relay, first, place = course.flight.config.relay, int((course.kinds == 0).sum()), course.place()[1:]
    serving = np.take_along_axis(place, course.assignment[1:, :, None].repeat(3, axis=2), axis=1)
    apart = np.linalg.norm(place[:, first:] - serving, axis=2)[:, course.kinds[first:] == kind, None]
    if not relay.require_link:
        return np.ones_like(apart, bool), np.ones_like(apart, bool)
    return apart <= relay.link_range + CLOSE, apart <= relay.link_range - CLOSE


def sensors(course: Course) -> Tally:
    """Return the sensors' AoI: a packet needs the nearest UAV, its relay, and a chance."""
    config = course.flight.config
    radio = config.radio
    may, must = nearest(course, 2, course.layout.sensor_xy)
    counts, counts_surely = linked(course, 2)
    flat = course.position[1:, course.kinds == 2, None] - course.layout.sensor_xy
    distance = np.sqrt((flat**2).sum(axis=3) + config.world.height_collection**2)
    chance = 1.0 - packet_loss(radio, received_mw(radio, distance) / noise_mw(radio))
    sure = chance == 1.0
    return Tally(
        course.aoi[:-1],
        course.aoi[1:],
        course.due()[0],
        config.world.aoi_max,
        may & counts & (chance > 0.99 * NEGLIGIBLE),
        must & counts_surely & sure,
        course.utility[:, course.kinds == 2],
    )


def plots(course: Course) -> Tally:
    """Return the plots' VDF: an image needs the nearest UAV, its relay, and enough grid cells within its range."""
    world, camera = course.flight.config.world, course.flight.config.camera
    x = (np.arange(world.plots_x * camera.grid_x) + 0.5) * world.field_x / (world.plots_x * camera.grid_x)
    y = (np.arange(world.plots_y * camera.grid_y) + 0.5) * world.field_y / (world.plots_y * camera.grid_y)
    centre_x = (np.arange(world.plots_x) + 0.5) * world.field_x / world.plots_x
    centre_y = (np.arange(world.plots_y) + 0.5) * world.field_y / world.plots_y
    centres = np.stack(np.meshgrid(centre_x, centre_y, indexing="ij"), axis=-1).reshape(-1, 2)
    own = course.position[1:, course.kinds == 1]
    square = (x - own[..., :1])[..., None] ** 2 + (y - own[..., 1:])[..., None, :] ** 2
    distance = np.sqrt(square + world.height_monitoring**2)
    shape = (*own.shape[:2], world.plots_x, camera.grid_x, world.plots_y, camera.grid_y)
    good, surely_good = (
        (distance < camera.image_distance + margin).reshape(shape).mean(axis=(3, 5)).reshape(*own.shape[:2], -1)
        for margin in (CLOSE, -CLOSE)
    )
    may, must = nearest(course, 1, centres)
    counts, counts_surely = linked(course, 1)
    flat = (course.steps, -1)
    return Tally(
        course.vdf[:-1].reshape(flat),
        course.vdf[1:].reshape(flat),
        course.due()[1].reshape(flat),
        world.vdf_max,
        may & counts & (good >= camera.plot_threshold - CLOSE),
        must & counts_surely & (surely_good >= camera.plot_threshold),
        course.utility[:, course.kinds == 1],
    )


def tallies(course: Course) -> tuple[Tally, Tally]:
    return sensors(course), plots(course)


@dose(12)
@given(flights())
def test_counters_stay_between_nothing_and_their_cap(flight):
    """AoI and VDF lie in 0..max, and are whole numbers."""
    course = fly(flight)
    for tally in tallies(course):
        values = np.concatenate([tally.before, tally.after])
        assert ((values >= 0.0) & (values <= tally.most)).all()
        assert (values == np.rint(values)).all()


@dose(12)
@given(flights())
def test_counters_rise_by_one_when_due_and_else_only_fall(flight):
    """Every counter is either at its unserved value or at 0."""
    course = fly(flight)
    for tally in tallies(course):
        assert ((tally.after == tally.raised) | (tally.after == 0.0)).all()


@dose(20)
@given(flights())
def test_counters_fall_only_where_a_uav_could_serve_them(flight):
    """Served means: by the nearest UAV of the right kind, near enough, with its relay in range; then it also must."""
    course = fly(flight)
    for tally in tallies(course):
        assert not ((tally.share > 0.0) & ~tally.possible.any(axis=1)).any()
        assert (tally.after[tally.certain.any(axis=1)] == 0.0).all()


@dose(20)
@given(flights())
def test_every_unit_is_credited_once_and_to_who_served_it(flight):
    """Per step, the credits sum to what fell, and each UAV has what it alone could serve, at most all it could."""
    course = fly(flight)
    for tally in tallies(course):
        fell = tally.before * tally.share
        np.testing.assert_array_equal(tally.credit.sum(axis=1), fell.sum(axis=1))
        alone = tally.possible & (tally.possible.sum(axis=1, keepdims=True) == 1)
        least, most = ((who * fell[:, None]).sum(axis=2) for who in (alone, tally.possible))
        assert (tally.credit >= least).all()
        assert (tally.credit <= most).all()
    assert not course.utility[:, course.kinds == 0].any()


@dose(12)
@given(flights())
def test_sensors_served_are_counted_once_and_for_who_served_them(flight):
    """`served_sensors` counts the deliveries of sensors that held data."""
    course = fly(flight)
    tally = sensors(course)
    share = tally.share * (tally.before > 0.0)
    alone = tally.possible & (tally.possible.sum(axis=1, keepdims=True) == 1)
    least, most = ((who * share[:, None]).sum(axis=2) for who in (alone, tally.possible))
    np.testing.assert_allclose(course.served_sensors.sum(axis=1), share.sum(axis=1), rtol=0.0, atol=1e-9)
    assert (course.served_sensors >= least - 1e-9).all()
    assert (course.served_sensors <= most + 1e-9).all()


@dose(12)
@given(flights())
def test_no_more_is_credited_and_held_than_was_supplied(flight):
    """Units held and credited grow by those that rise, less the rises that a cap or an image at that step takes."""
    for tally in tallies(fly(flight)):
        supplied = tally.before[0].sum() + np.cumsum(tally.due.sum(axis=1))
        gone = supplied - tally.after.sum(axis=1) - np.cumsum(tally.credit.sum(axis=1))
        lost = np.diff(gone, prepend=0.0)
        may_be_lost = tally.due & ((tally.before > tally.most - 1.0) | (tally.share > 0.0))
        assert (lost >= -1e-9).all()
        assert (lost <= may_be_lost.sum(axis=1) + 1e-9).all()
