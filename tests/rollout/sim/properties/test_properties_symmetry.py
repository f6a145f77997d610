"""Mirrored and turned farms give mirrored and turned results.

Everything stands on a lattice of binary fractions, so that a mirrored distance is the same float64 and whatever is
compared by distance falls alike. What is ranked by other rules (the first of equal quadrants, the positive side of
what lies level, the lower number of sensors equally far) has no mirror image there, and is not compared.

Mirrored views undo mirrors: those of a mirrored farm are the same but for the signs of the axes.
"""

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.actions.adapters import SIGNS
from eia_sec.common.config import FarmConfig, ObservationConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.sim.layout import Layout
from eia_sec.rollout.sim.start import start_levels
from tests.constants import with_constants
from tests.rollout.sim.properties.strategies import (
    Flight,
    dose,
    farm_configs,
    instant_farms,
    placed,
    renumbered,
    worlds,
)

MOTIVATION = REWARD_PARTS.index("motivation")
EXACT = {"rtol": 1e-9, "atol": 1e-9}
FINE = 256
"""Sensors stand at multiples of 1/FINE m, UAVs at multiples of 1/64 m."""


@dataclass(frozen=True)
class Symmetry:
    """A mirror in x, one in y, and the exchange of the axes, in this order.

    Attributes:
        flip_x: whether x counts from the other side.
        flip_y: whether y does.
        swap: whether the axes change their names.
    """

    flip_x: bool
    flip_y: bool
    swap: bool

    def config(self, config: FarmConfig) -> FarmConfig:
        """Return the farm seen this way."""
        if not self.swap:
            return config
        world = config.world
        turned = replace(
            world,
            field_x=world.field_y,
            field_y=world.field_x,
            plots_x=world.plots_y,
            plots_y=world.plots_x,
            speed_x_max=world.speed_y_max,
            speed_y_max=world.speed_x_max,
        )
        return replace(config, world=turned)

    def vectors(self, vectors: np.ndarray) -> np.ndarray:
        """Return velocities, directions or offsets [..., 2]."""
        signs = np.where([self.flip_x, self.flip_y], -1.0, 1.0).astype(vectors.dtype)
        return (vectors * signs)[..., ::-1] if self.swap else vectors * signs

    def places(self, places: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Return places [..., 2] of a field of this size [2]."""
        seen = np.where([self.flip_x, self.flip_y], size - places, places)
        return seen[..., ::-1] if self.swap else seen

    def plots(self, plots: np.ndarray) -> np.ndarray:
        """Return what is laid out in columns and rows, [..., X, Y]."""
        if self.flip_x:
            plots = plots[..., ::-1, :]
        if self.flip_y:
            plots = plots[..., ::-1]
        return np.swapaxes(plots, -1, -2) if self.swap else plots


SYMMETRIES = st.builds(Symmetry, st.booleans(), st.booleans(), st.booleans()).filter(
    lambda symmetry: symmetry != Symmetry(False, False, False)
)


def without_added(seen: ObservationConfig) -> ObservationConfig:
    """Return observations without the added ones: a UAV between two lattice points belongs to the one further on."""
    usual = preset("eia-sec").farm.observation
    names = ("peers", "last_move", "closing", "units", "plan", "fields", "coarse", "phases", "route", "service", "link")
    names += ("stress", "charge", "wind", "zones")
    return replace(seen, **{name: getattr(usual, name) for name in names})


@st.composite
def lattice_flights(draw: st.DrawFn) -> Flight:
    """Draw a farm whose plots and speeds are binary fractions, and whose packets need no luck."""
    config: FarmConfig = draw(instant_farms(farm_configs(worlds(st.integers(1, 6), 60, lattice=True))))
    config = replace(config, observation=without_added(config.observation))
    config = replace(config, radio=with_constants(config.radio, sensor_power_dbm=90.0))
    manner = draw(st.sampled_from(["uniform", "lasting", "saturated", "hovering", "corners"]))
    return Flight(config, draw(st.integers(0, 500)), draw(st.integers(0, 500)), draw(GROUNDS), "seeded", manner)


GROUNDS = st.sampled_from(["seeded", "borders"])


def lattice(values: np.ndarray, parts: int) -> np.ndarray:
    return np.rint(values * parts) / parts


def start(
    config: FarmConfig, flight: Flight, layout: Layout, place: np.ndarray, levels: tuple[np.ndarray, np.ndarray]
) -> FarmBatch:
    batch = FarmBatch(config, 1)
    with placed(layout, place, levels):
        batch.reset(0, flight.farm, flight.episode)
    return batch


@dataclass(eq=False)
class Pair:
    """A farm and its image, flown side by side.

    Attributes:
        symmetry: how the image is made.
        config: the farm.
        layout: of the farm.
        order: [S] sensors of the farm, in the image's numbers.
        farm: the batch of the farm.
        image: the batch of its image.
        pointed: [n] whether the direction that each UAV sees has an image.
    """

    symmetry: Symmetry
    config: FarmConfig
    layout: Layout
    order: np.ndarray
    farm: FarmBatch
    image: FarmBatch
    pointed: np.ndarray

    @classmethod
    def of(cls, flight: Flight, symmetry: Symmetry) -> "Pair":
        """Start both episodes."""
        config, size, turned = flight.config, flight.size, symmetry.config(flight.config)
        layout, _ = renumbered(config, flight.layout(), lattice(flight.layout().sensor_xy, FINE))
        moved, order = renumbered(turned, layout, symmetry.places(layout.sensor_xy, size))
        place = lattice(flight.positions(), 64)
        age, level = start_levels(config.world, flight.farm, flight.episode)
        farm = start(config, flight, layout, place, (age, level))
        seen = (age[order], np.ascontiguousarray(symmetry.plots(level)))
        image = start(turned, flight, moved, symmetry.places(place, size), seen)
        pair = cls(symmetry, config, layout, order, farm, image, np.empty(0))
        pair.pointed = pair.have_direction()
        return pair

    def step(self, action: np.ndarray) -> None:
        """Step both; actions [2 n] are multiples of 1/64."""
        self.farm.step(action[None])
        self.image.step(self.symmetry.vectors(action.reshape(-1, 2)).reshape(1, -1))

    def places(self) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Return for each UAV with a task its number, the places [I, 2] of its task and their counters [I]."""
        world = self.config.world
        x = (np.arange(world.plots_x) + 0.5) * world.field_x / world.plots_x
        y = (np.arange(world.plots_y) + 0.5) * world.field_y / world.plots_y
        centres = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        first, second = world.communication_uavs, world.communication_uavs + world.monitoring_uavs
        monitors = [(u, centres, self.farm.vdf[0].reshape(-1)) for u in range(first, second)]
        return monitors + [(u, self.layout.sensor_xy, self.farm.aoi[0]) for u in range(second, world.uavs)]

    def have_direction(self) -> np.ndarray:
        """Return whose direction has an image, [n]: nothing lies level with the UAV, and one quadrant wins."""
        clear = np.ones(self.config.world.uavs, bool)
        for u, places, value in self.places():
            offset = places - self.farm.position[0, u]
            right, upper = (offset > 0.0).T
            sums = np.array(
                [value[quadrant].sum() for quadrant in (right & upper, ~right & upper, ~right & ~upper, right & ~upper)]
            )
            second, first = np.sort(sums)[-2:]
            clear[u] = not (offset == 0.0)[value > 0.0].any() and (first - second > 1e-9 or not value.any())
        return clear

    def assert_images(self, motivated: np.ndarray) -> None:
        """Compare all results of both; motivation only of those UAVs [n] whose last direction had an image."""
        farm, image, see = self.farm, self.image, self.symmetry
        size = np.array([self.config.world.field_x, self.config.world.field_y])
        np.testing.assert_array_equal(image.position[0], see.places(farm.position[0], size))
        np.testing.assert_array_equal(image.assignment, farm.assignment)
        np.testing.assert_array_equal(image.energy, farm.energy)
        np.testing.assert_array_equal(image.vdf[0], see.plots(farm.vdf[0]))
        np.testing.assert_allclose(image.aoi[0], farm.aoi[0][self.order], **EXACT)
        np.testing.assert_allclose(image.utility, farm.utility, **EXACT)
        np.testing.assert_allclose(image.served_sensors, farm.served_sensors, **EXACT)
        np.testing.assert_allclose(image.service, farm.service, **EXACT)
        parts = np.ones(farm.parts.shape[1:], bool)
        parts[:, MOTIVATION] = motivated
        np.testing.assert_allclose(image.parts[0][parts], farm.parts[0][parts], **EXACT)
        np.testing.assert_allclose(image.reward[0][motivated], farm.reward[0][motivated], rtol=1e-6, atol=1e-6)
        self.pointed = self.have_direction()
        ours, theirs = see.vectors(farm.direction[0])[self.pointed], image.direction[0][self.pointed]
        np.testing.assert_array_equal(theirs, ours)
        expected, compared = self.observations()
        np.testing.assert_allclose(image.observation[0][compared], expected[compared], rtol=0.0, atol=1e-6)

    def observations(self) -> tuple[np.ndarray, np.ndarray]:
        """Return what the image should see, [O], and where that follows, [O]."""
        team = farm_team(self.config)
        row = self.farm.observation[0].copy()
        compared = np.ones(row.shape, bool)
        views, masks = team.split_observations(row), team.split_observations(compared)
        seen = self.config.observation
        width, side, first = 1 if seen.form == "printed" else 3, seen.window, 4 if seen.mirrored else 2
        last, behind = first + width * seen.sensors, first + side**2
        sensors = range(first + 1, last, 3) if width == 3 else ()
        lattice = (behind + 5,) if seen.lattice else ()
        uavs = range(first, first + 15, 3)
        vectors = ((0, *uavs), (0, behind, behind + 2, *lattice), (0, *sensors, last, last + 2))
        change = replace(self.symmetry, flip_x=False, flip_y=False) if seen.mirrored else self.symmetry
        for view, starts in zip(views, vectors, strict=True):
            for at in starts:
                view[:, at : at + 2] = change.vectors(view[:, at : at + 2])
            if seen.mirrored:
                view[:, SIGNS] = self.symmetry.vectors(view[:, SIGNS])
        views[1][:, first:behind] = change.plots(views[1][:, first:behind].reshape(-1, side, side)).reshape(-1, side**2)
        pointed = np.split(self.pointed, [slice.start for slice in team.agent_slices()[1:]])
        masks[1][~pointed[1], behind : behind + 2] = False
        masks[2][~pointed[2], last : last + 2] = False
        between = self.on_plot_borders()
        masks[1][between, first:behind] = False
        if seen.lattice:
            masks[1][between, behind + 5 : behind + 7] = False
        masks[2][self.sensors_equally_far(), first:last] = False
        if seen.mirrored:
            for mask, unmoved in zip(
                masks, np.split(self.without_image(), [len(masks[0]), -len(masks[2])]), strict=True
            ):
                mask[unmoved] = False
            masks[1][between] = False
        return row, compared

    def without_image(self) -> np.ndarray:
        """Return which UAVs [n] are exactly in the middle of what decides their axes."""
        world = self.config.world
        span = np.tile([world.field_x, world.field_y], (world.uavs, 1))
        monitors = slice(world.communication_uavs, world.communication_uavs + world.monitoring_uavs)
        span[monitors] /= world.plots_x, world.plots_y
        return (self.farm.position[0] % span == span / 2.0).any(axis=1)

    def on_plot_borders(self) -> np.ndarray:
        """Return which monitoring UAVs [n_m] fly between two plots."""
        world = self.config.world
        first = world.communication_uavs
        place = self.farm.position[0, first : first + world.monitoring_uavs]
        inside = (place > 0.0) & (place < (world.field_x, world.field_y))
        between = place % (world.field_x / world.plots_x, world.field_y / world.plots_y) == 0.0
        return (inside & between).any(axis=1)

    def sensors_equally_far(self) -> np.ndarray:
        """Return which data collection UAVs [n_d] have two sensors at one distance."""
        own = self.farm.position[0, -self.config.world.collection_uavs :]
        square = np.sort(((own[:, None] - self.layout.sensor_xy) ** 2).sum(axis=2), axis=1)
        return (np.diff(square, axis=1) == 0.0).any(axis=1)


@dose(20)
@given(lattice_flights(), SYMMETRIES)
def test_images_of_a_farm_give_images_of_its_results(flight, symmetry):
    """Positions, counters, relays, energy, rewards, directions and observations after every step."""
    pair = Pair.of(flight, symmetry)
    actions = lattice(flight.actions(), 64)
    pair.assert_images(np.ones(flight.config.world.uavs, bool))
    for action in actions:
        motivated = pair.pointed
        pair.step(action)
        pair.assert_images(motivated)


def test_most_directions_have_images():
    """Ties excuse few directions: the default dose compares most of those of farms with something to do."""
    compared = []

    @dose(10)
    @given(lattice_flights())
    def collect(flight):
        pair = Pair.of(flight, Symmetry(True, True, False))
        for action in lattice(flight.actions(), 64):
            pair.step(action)
            busy = pair.farm.direction[0].any(axis=1)
            compared.extend(pair.have_direction()[busy])

    collect()
    assert np.mean(compared) > 0.5
