"""What the property tests draw: farms with every switch, positions, and commands.

A drawn `Flight` is a recipe of a few numbers and words, so that a failing example prints as code that makes it again.
"""

import os
import typing
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, ClassVar
from unittest.mock import patch

import numpy as np
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

from eia_sec.common.config import DynamicsConfig, FarmConfig, RewardConfig, WorldConfig
from eia_sec.common.team import Float32
from eia_sec.rollout.sim import batch
from eia_sec.rollout.sim.core.cells import cell_counts
from eia_sec.rollout.sim.layout import Layout, make_layout
from eia_sec.rollout.sim.reference import farm
from eia_sec.rollout.sim.start import start_positions
from tests.constants import with_constants

DOSE = os.environ.get("EIA_SEC_PROPERTIES", "fixed")
"""fixed: the same few examples every time; plain: these, and failures are not made small; many: random ones."""
MORE = 24
"""How many times as many examples `many` tries."""


def dose(examples: int) -> settings:
    """Return the settings of a property test that tries so many examples in the default dose."""
    phases = [Phase.explicit, Phase.generate] + [Phase.shrink] * (DOSE != "plain")
    if DOSE == "many":
        return settings(
            max_examples=MORE * examples, deadline=None, print_blob=True, phases=phases, suppress_health_check=SLOW
        )
    return settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        deadline=None,
        phases=phases,
        suppress_health_check=SLOW,
    )


SLOW = (HealthCheck.too_slow, HealthCheck.data_too_large)

APART = ("base", "link", "relayed", "stress", "charge", "wind", "zones")
"""What tests of their own draw (of links, chains, stress, batteries, wind and zones), and is off elsewhere;
`test_properties_added` has the switches of observations on."""
GROUNDS = ("seeded", "borders", "heap")
STARTS = ("seeded", "together", "corners", "plots")
MANNERS = ("uniform", "lasting", "saturated", "hovering", "corners", "tiny")


def switches(section: type) -> dict[str, st.SearchStrategy[Any]]:
    """Return a strategy for every Literal and boolean of a section, found by its annotations."""
    drawn: dict[str, st.SearchStrategy[Any]] = {}
    for name, kind in typing.get_type_hints(section).items():
        if name in APART:
            continue
        if typing.get_origin(kind) is typing.Literal:
            drawn[name] = st.sampled_from(typing.get_args(kind))
        elif kind is bool:
            drawn[name] = st.booleans()
    return drawn


def sections() -> dict[str, type]:
    """Return the sections of a farm's configuration by their names."""
    return {f.name: typing.get_type_hints(FarmConfig)[f.name] for f in fields(FarmConfig)}


COUNTS = st.one_of(st.integers(1, 5), st.integers(1, 24))
SIDES = st.one_of(st.sampled_from([40.0, 90.0, 170.0, 400.0]), st.floats(40.0, 420.0).map(lambda side: round(side, 2)))
PLOT_SIDES = st.sampled_from([4.0, 7.0, 12.5, 20.0, 40.0])
SIGNED = st.sampled_from([-1.0, 0.0, 0.25, 1.0, 6.0])

CONSTANTS: dict[str, dict[str, st.SearchStrategy[Any]]] = {
    "world": {
        "aoi_max": st.integers(1, 6),
        "vdf_max": st.integers(1, 6),
        "height_communication": st.sampled_from([18.0, 22.0, 60.0]),
        "height_monitoring": st.sampled_from([5.0, 18.0, 20.0]),
        "height_collection": st.sampled_from([2.0, 18.0, 22.0]),
    },
    "radio": {"sensor_power_dbm": st.sampled_from([-60.0, -10.0, 0.0, 10.0, 30.0, 90.0])},
    "camera": {
        "image_distance": st.sampled_from([4.1237, 19.1357, 25.3712, 40.7172, 120.0, 1000.0]),
        "plot_threshold": st.sampled_from([0.0, 0.3, 0.75, 1.0]),
    },
    "reward": {name: SIGNED for name, kind in typing.get_type_hints(RewardConfig).items() if kind == ClassVar[float]},
    "dynamics": {"airspeed": st.sampled_from([(12.0,), (12.0, 5.0, 40.0)])},
}
"""Constants that are no options, by section."""


def on_lattice(world: WorldConfig) -> bool:
    """Return whether plots end at binary fractions, so that distances between what stands there are exact."""
    return (16.0 * world.field_x / world.plots_x).is_integer() and (16.0 * world.field_y / world.plots_y).is_integer()


@st.composite
def fields_with_plots(draw: st.DrawFn, lattice: bool) -> dict[str, Any]:
    """Draw the field's sides and its plots, not always square."""
    plots = {"plots_x": draw(st.integers(1, 10)), "plots_y": draw(st.integers(1, 10))}
    if not lattice:
        return {"field_x": draw(SIDES), "field_y": draw(SIDES), **plots}
    side_x, side_y = draw(PLOT_SIDES), draw(PLOT_SIDES)
    plots = {"plots_x": max(plots["plots_x"], int(40 // side_x)), "plots_y": max(plots["plots_y"], int(40 // side_y))}
    return {"field_x": side_x * plots["plots_x"], "field_y": side_y * plots["plots_y"], **plots}


@st.composite
def worlds(
    draw: st.DrawFn, counts: st.SearchStrategy[int] = COUNTS, sensors: int = 200, lattice: bool | None = None
) -> WorldConfig:
    """Draw counts, geometry and clocks; cycles are short, so that much happens in a short episode."""
    seconds = draw(st.sampled_from([0.25, 0.5, 1.0, 2.0]))
    cycles = st.integers(1, 9).map(lambda number: number * max(1, int(seconds)))
    ground = draw(fields_with_plots(draw(st.booleans()) if lattice is None else lattice))
    number = draw(st.one_of(st.integers(1, 12), st.integers(1, sensors), st.integers(sensors * 5 // 8, sensors)))
    world = WorldConfig(
        communication_uavs=draw(counts),
        monitoring_uavs=draw(counts),
        collection_uavs=draw(counts),
        sensors=number,
        sensor_spacing=draw(st.sampled_from([0.0, 0.2, 0.4])) * (ground["field_x"] * ground["field_y"] / number) ** 0.5,
        sensor_cycles=tuple(draw(st.lists(cycles, min_size=1, max_size=4))),
        vdf_cycle=draw(cycles),
        steps=draw(st.integers(1, 30)),
        step_seconds=seconds,
        speed_x_max=draw(st.sampled_from([0.5, 4.0, 10.0, 40.0])),
        speed_y_max=draw(st.sampled_from([0.5, 4.0, 10.0, 40.0])),
        **ground,
    )
    constants = {name: draw(choice) for name, choice in CONSTANTS["world"].items()}
    world = with_constants(world, **constants)
    return replace(world, **{name: draw(choice) for name, choice in switches(WorldConfig).items()})


def numbers(world: WorldConfig) -> dict[str, dict[str, st.SearchStrategy[Any]]]:
    """Return strategies for the numbers of the other sections that decide what happens."""
    served = world.monitoring_uavs + world.collection_uavs
    least = -(-served // world.communication_uavs)
    return {
        "relay": {
            "capacity": st.one_of(st.just(0), st.integers(least, least + 4)),
            "link_range": st.sampled_from([30.0, 61.5, 150.0]),
        },
        "observation": {
            "sensors": st.one_of(st.integers(1, min(10, world.sensors)), st.just(world.sensors)),
            "window": st.sampled_from([1, 3, 3, 5, 9]),
            "peers": st.sampled_from([0, 0, 1, 2, 5]),
            "units": st.sampled_from([0, 0, 1, 2]),
        },
        "dynamics": {
            "acceleration": st.sampled_from([(3.0,), (0.7, 3.0, 9.0)]),
            "jerk": st.sampled_from([(4.0,), (50.0,), (1.0, 4.0, 8.0)]),
            "delay": st.sampled_from([(0.0,), (0.2,), (0.25, 0.0, 0.1)]),
            "speed": st.sampled_from([(8.4,), (30.0, 3.0, 8.4)]),
        },
        "control": {name: st.sampled_from([0.01, 0.36, 0.5, 0.5]) for name in ("monitoring_inset", "collection_inset")},
    }


@st.composite
def farm_configs(draw: st.DrawFn, world: st.SearchStrategy[WorldConfig] | None = None) -> FarmConfig:
    """Draw a farm: its world first, then every switch and the numbers that matter of every other section."""
    place = draw(worlds() if world is None else world)
    chosen = numbers(place)
    parts = {
        name: kind(**{key: draw(choice) for key, choice in {**chosen.get(name, {}), **switches(kind)}.items()})
        for name, kind in sections().items()
        if name != "world"
    }
    for name in parts.keys() & CONSTANTS.keys():
        parts[name] = with_constants(parts[name], **{key: draw(choice) for key, choice in CONSTANTS[name].items()})
    if parts["dynamics"].inertial:
        parts["observation"] = replace(parts["observation"], route=False, plan=0)
    return FarmConfig(world=place, **parts)


def instant_farms(configs: st.SearchStrategy[FarmConfig] | None = None) -> st.SearchStrategy[FarmConfig]:
    """Draw farms whose UAVs reach any velocity at once."""
    drawn = farm_configs() if configs is None else configs
    return drawn.map(lambda config: replace(config, dynamics=DynamicsConfig()))


def differences(config: Any) -> str:
    """Return code that makes a configuration, without what is as by default."""
    usual, changed = type(config)(), []
    for f in fields(config):
        value = getattr(config, f.name)
        if value != getattr(usual, f.name):
            changed.append(f"{f.name}={differences(value) if is_dataclass(value) else repr(value)}")
    return f"{type(config).__name__}({', '.join(changed)})"


def renumbered(config: FarmConfig, layout: Layout, xy: np.ndarray) -> tuple[Layout, np.ndarray]:
    """Return the layout with its sensors moved to places [S, 2] and numbered by cells, and their old numbers [S]."""
    world, cells = config.world, cell_counts(config.world)
    column = np.minimum((xy[:, 0] / world.field_x * cells[0]).astype(np.int64), cells[0] - 1)
    row = np.minimum((xy[:, 1] / world.field_y * cells[1]).astype(np.int64), cells[1] - 1)
    cell = column * cells[1] + row
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(cells[0] * cells[1] + 1)).astype(np.int64)
    moved = replace(
        layout,
        sensor_xy=np.ascontiguousarray(xy[order]),
        sensor_type=layout.sensor_type[order],
        sensor_cycle_steps=layout.sensor_cycle_steps[order],
        cells=cells,
        cell_start=start,
    )
    return moved, order


@dataclass(frozen=True, repr=False)
class Flight:
    """A recipe of one short episode.

    Attributes:
        config: the farm.
        farm: its seed.
        episode: seed of the episode; the actions follow from it too.
        ground: sensors where the seed puts them; a share of their coordinates on the border; or in one heap.
        starts: UAVs where the seed puts them; on corners, sides' middles and the centre; in three places; or on
            plots' centres and edges.
        manner: how the UAVs fly.
    """

    config: FarmConfig
    farm: int
    episode: int
    ground: str = "seeded"
    starts: str = "seeded"
    manner: str = "uniform"

    def __repr__(self) -> str:
        """Return the call that makes this flight."""
        rest = (self.farm, self.episode, self.ground, self.starts, self.manner)
        return f"Flight({differences(self.config)}, {', '.join(map(repr, rest))})"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(repr(self))

    @property
    def size(self) -> np.ndarray:
        """The field's sides [2], m."""
        return np.array([self.config.world.field_x, self.config.world.field_y])

    def layout(self) -> Layout:
        """Return the positions of the sensors."""
        layout = make_layout(self.config, self.farm)
        if self.ground == "seeded":
            return layout
        random, xy = np.random.default_rng((self.farm, 1)), layout.sensor_xy.copy()
        if self.ground == "borders":
            pushed = random.uniform(size=xy.shape) < 0.5
            xy = np.where(pushed, random.integers(0, 2, xy.shape) * self.size, xy)
        else:
            spot = random.uniform(0.0, self.size)
            xy = np.clip(spot + random.integers(-2, 3, xy.shape) * 0.5, 0.0, self.size)
        return renumbered(self.config, layout, xy)[0]

    def positions(self) -> np.ndarray:
        """Return where the UAVs start, [n, 2] m."""
        world, random = self.config.world, np.random.default_rng((self.episode, 2))
        shape = (world.uavs, 2)
        if self.starts == "corners":
            return random.integers(0, 3, shape) / 2.0 * self.size
        if self.starts == "together":
            return random.uniform(0.0, self.size, (3, 2))[random.integers(0, 3, world.uavs)]
        if self.starts == "plots":
            plots = np.array([world.plots_x, world.plots_y])
            return random.integers(0, 2 * plots + 1, shape) * (self.size / (2 * plots))
        if world.safety_distance * world.uavs**0.5 > self.size.min():
            return random.uniform(0.0, self.size, shape)  # crowded planes take the search for places seconds
        return start_positions(world, self.farm, self.episode)

    def actions(self) -> Float32:
        """Return what is commanded, [steps, 2 n]; partly out of range."""
        world, random = self.config.world, np.random.default_rng((self.episode, 3))
        shape = (world.steps, 2 * world.uavs)
        action = random.uniform(-1.2, 1.2, shape)
        if self.manner == "lasting":
            action[:] = action[:1]
        elif self.manner == "saturated":
            action = random.choice([-1e30, -1.0, 1.0, 3.0], shape)
        elif self.manner == "hovering":
            action *= np.repeat(random.uniform(size=(world.steps, world.uavs)) < 0.15, 2, axis=1)
        elif self.manner == "corners":
            action[:] = random.choice([-1.0, 1.0], shape[1])
        elif self.manner == "tiny":
            action *= 10.0 ** random.integers(-40, -1, shape)
        return action.astype(np.float32)


@st.composite
def flights(draw: st.DrawFn, configs: st.SearchStrategy[FarmConfig] | None = None) -> Flight:
    """Draw a short episode on any farm; UAVs start equally far from something only where that is exact."""
    config = draw(farm_configs() if configs is None else configs)
    return Flight(
        config,
        draw(st.integers(0, 500)),
        draw(st.integers(0, 500)),
        draw(st.sampled_from(GROUNDS)),
        draw(st.sampled_from(STARTS if on_lattice(config.world) else STARTS[:2])),
        draw(st.sampled_from(MANNERS)),
    )


@contextmanager
def placed(
    layout: Layout, positions: np.ndarray, levels: tuple[np.ndarray, np.ndarray] | None = None
) -> Iterator[None]:
    """Let episodes that begin inside this block begin on this ground, at these places and with these levels."""
    changes: dict[str, Any] = {"make_layout": lambda *_: layout, "start_positions": lambda *_: positions.copy()}
    if levels is not None:
        changes["start_levels"] = lambda *_: (levels[0].copy(), levels[1].copy())
    with patch.multiple(batch, **changes):
        changes.pop("make_layout")
        with patch.multiple(farm, **changes):
            yield
