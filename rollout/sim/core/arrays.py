"""The arrays of a simulated farm, each declared once, and their sizes."""

from collections.abc import Mapping
from typing import Annotated, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import farm_team
from eia_sec.rollout.sim.core.assignment import AssignmentScratch, Exchanges
from eia_sec.rollout.sim.core.cells import cell_counts
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.records import Array, Flags, Float32, Indices, Int32, Site, Steps, make_record
from eia_sec.rollout.sim.observation.arrays import ViewScratch, make_view_scratch
from eia_sec.rollout.sim.observation.plans.arrays import PlanScratch, make_plan_scratch

REWARD_PARTS: Final = ("positioning", "energy", "risk", "boundary", "utility", "idle", "motivation", "relayed")
"""The weighted parts of a reward in storage order; the reward is their sum."""


class Farm(NamedTuple):
    """State of one farm; the arrays of a batch have a first axis [E] before these, see `make_state`.

    Axes are named as in the paper: n UAVs in row order, n_c relays, n_m monitoring and n_d data collection UAVs, S
    sensors, n_px by n_py plots. `axis_sizes` has the others; what a configuration does not need has size 0.
    """

    key: Annotated[NDArray[np.uint64], "1", "packet key of the episode, see `start.packet_key`"]
    time: Annotated[Indices, "1", "steps done; -1 before the first reset"]
    position: Annotated[Array, "n 2", "m"]
    motion: Annotated[Array, "n_inertial 6", "velocity, acceleration and last command, see `core.dynamics`"]
    direction: Annotated[Array, "n 2", "current D_VDF and D_AoI"]
    assignment: Annotated[Indices, "served", "relay of each served UAV"]
    service: Annotated[Array, "n_c", "D_c, m"]
    sensor: Annotated[Array, "2 S", "sensor positions, m"]
    cell_start: Annotated[Int32, "cells+1", "first sensor of each cell"]
    by_row: Annotated[Int32, "S", "the sensors row by row of cells"]
    row_start: Annotated[Int32, "cells+1", "where each cell's sensors begin in that list, row by row"]
    cycle: Annotated[Int32, "S", "T_UA, steps"]
    age: Annotated[Array, "S", "AoI"]
    age_due: Annotated[Int32, "S", "step at which AoI rises next"]
    level: Annotated[Array, "n_px n_py", "VDF"]
    level_due: Annotated[Int32, "n_px n_py", "step at which VDF rises next"]
    sweep: Annotated[
        Int32,
        "n_m 2",
        "sweep route of each monitoring UAV and the box on it that comes next, see `observation.routes`",
    ]
    observation: Annotated[Float32, "O", "observations"]
    reward: Annotated[Float32, "n", "reward of the last step"]
    parts: Annotated[Array, "n K", "reward parts of the last step"]
    energy: Annotated[Array, "n", "energy used in the last step, J"]
    utility: Annotated[Array, "n", "VMUF and DCUF of the last step"]
    served: Annotated[Array, "n_d", "sensors with AoI above 0 that delivered in the last step"]
    returns: Annotated[Array, "n", "sums of the episode's rewards so far"]
    sums: Annotated[
        Array,
        "5",
        "sums over the episode's steps: mean AoI, mean VDF, crowded UAVs, UAVs outside, energy in J",
    ]
    rising: Annotated[Indices, "2", "next step at which any AoI rises, and the same for VDF"]
    age_below: Annotated[Array, "cells_y+1 cells_x", "tally of AoI over the sensor cells, see `core.tallies`"]
    age_above: Annotated[Array, "cells_y+1 cells_x", "the tally's other table"]
    waiting: Annotated[Indices, "1", "number of sensors that hold data"]
    level_below: Annotated[Array, "n_py+1 n_px", "tally of VDF over the plots"]
    level_above: Annotated[Array, "n_py+1 n_px", "the tally's other table"]
    listed: Annotated[Indices, "n_d listed", "sensors that each data collection UAV sees"]
    quality: Annotated[Array, "served", "signal-to-noise ratio of the link to the relay, dB"]
    plot_visit: Annotated[Int32, "tracked_plots 4", "last visit of each plot, see `hindsight`"]
    sensor_visit: Annotated[Int32, "tracked_sensors 4", "the same of each sensor"]
    failure: Annotated[Int32, "n", "first step of which each UAV is no part"]
    gone: Annotated[
        Flags,
        "n",
        "whether each UAV has failed, see `conditions.failures`; the position of one that has is infinite",
    ]
    living: Annotated[Indices, "3", "UAVs of each type that have not failed"]
    shown: Annotated[Array, "n_lost 2", "positions, of UAVs that have failed the last ones, m"]
    charge: Annotated[Array, "n_charged", "of the batteries, J"]
    patch_place: Annotated[Array, "patches 2", "centres of the patches of stress, m"]
    patch_time: Annotated[Int32, "patches 2", "first step of each patch, and the first one without it"]
    patch_known: Annotated[Flags, "patches", "whether the team knows it"]
    stressed: Annotated[Array, "mapped_px n_py", "1 for plots in areas, and in living patches that are known"]
    plot_cycle: Annotated[
        Int32,
        "2 stressed_px n_py",
        "present cycle of each plot's VDF, and its growth because of areas",
    ]
    sensor_cycle: Annotated[
        Int32,
        "2 stressed_sensors",
        "cycle without stress of each sensor's AoI, and its growth because of areas",
    ]
    wind: Annotated[Array, "winds 2", "wind of each step, m/s"]
    zone_side: Annotated[Array, "sides 4", "sides of the no-fly zones, see `conditions.zones`"]
    zone_box: Annotated[Array, "zones 4", "boxes around them"]
    barred: Annotated[Steps, "ways", "barred steps from each lattice point, see `conditions.ways`"]
    closed: Annotated[Flags, "closing", "whether zones shut each plot off"]
    plan_first: Annotated[Int32, "S+1", "where the lattice points of each sensor begin in `plan_point`"]
    plan_point: Annotated[Site, "pairs", "lattice points at which a sensor is heard, see `observation.plans.places`"]
    plan_chance: Annotated[Float32, "pairs", "probability that its packets arrive there"]
    hindsight: Annotated[Float32, "tracked_steps n", "corrections of the episode's rewards"]


class Scratch(NamedTuple):
    """Working memory of one environment's step."""

    previous: Annotated[Array, "n 2", "positions before the step, m"]
    outside: Annotated[Array, "n", "ACT"]
    motivated: Annotated[Array, "n", "M_V or M_D"]
    neighbour: Annotated[Indices, "n", "nearest UAV"]
    distance: Annotated[Array, "n", "d_U, m"]
    crowded: Annotated[Array, "n", "whether another UAV of the plane is closer than the collision distance"]
    linked: Annotated[Array, "served", "whether the UAV's relay is in range, and joined if there is a base station"]
    joined: Annotated[Flags, "n_c", "whether each relay is joined to the base station, see `conditions.links`"]
    joined_then: Annotated[Flags, "n_c", "the same if one relay stood elsewhere"]
    queue: Annotated[Indices, "n_c", "relays that are joined"]
    earlier: Annotated[Array, "n_c", "D_c(k-1), m"]
    centroid: Annotated[Array, "n_c+1 3", "centroids of the served UAVs; the last row is that of all relays, m"]
    farthest: Annotated[Indices, "n_c", "farthest UAV served"]
    number: Annotated[Array, "n_c", "number of UAVs served"]
    far: Annotated[Array, "n_c", "distance of the farthest UAV, m"]
    peer: Annotated[Indices, "n", "nearest UAV of the plane"]
    apart_square: Annotated[Array, "n", "square of its distance, m^2"]
    x: Annotated[Array, "n", "positions along x, m"]
    y: Annotated[Array, "n", "positions along y, m"]
    around: Annotated[Indices, "S+1", "sensors around a UAV; the last entry is never read"]
    square: Annotated[Array, "S+1", "squares of their distances, m^2"]
    nearest_square: Annotated[Array, "listed", "squares of the distances of the nearest, m^2"]
    way_steps: Annotated[Int32, "ways", "steps of ways round zones, see `conditions.ways`"]
    way_queue: Annotated[Int32, "ways", "lattice points of these ways"]
    item: Annotated[Indices, "items", "sensors or plots served"]
    assigning: AssignmentScratch
    added: ViewScratch
    plot_plan: PlanScratch
    sensor_plan: PlanScratch


class Workspace(NamedTuple):
    """All data that one thread works with: numbers, the environments [E] that threads share, and its working memory.

    `action` [E, 2 n] holds the actions of the next step.
    """

    constants: Constants
    state: Farm
    scratch: Scratch
    action: Float32


def axis_sizes(config: FarmConfig, numbers: Constants, hindsight: bool) -> Mapping[str, int]:
    """Return the size of each named axis; visits are tracked if `hindsight` is set."""
    world, seen, stress = config.world, config.observation, config.stress
    n_c, n_m, n_d = world.counts
    columns, rows = cell_counts(world)
    ways = numbers.ways.columns * numbers.ways.rows
    slots = n_c * config.relay.capacity_for(world)
    if config.loses_uavs:
        slots = max(slots, n_m + n_d + n_c - 1)  # a living relay may serve more, see `capacity_left`
    return {
        "n": world.uavs,
        "n_c": n_c,
        "n_m": n_m,
        "n_d": n_d,
        "served": n_m + n_d,
        "slots": slots,
        "S": world.sensors,
        "n_px": world.plots_x,
        "n_py": world.plots_y,
        "cells": columns * rows,
        "cells_x": columns,
        "cells_y": rows,
        "items": max(world.sensors, world.plots_x * world.plots_y),
        "listed": seen.sensors,
        "O": farm_team(config).observation_size,
        "K": len(REWARD_PARTS),
        "tracked_plots": hindsight * world.plots_x * world.plots_y,
        "tracked_sensors": hindsight * world.sensors,
        "tracked_steps": hindsight * world.steps,
        "n_inertial": config.dynamics.inertial * world.uavs,
        "n_lost": config.loses_uavs * world.uavs,
        "n_charged": config.battery.some * world.uavs,
        "patches": stress.patches,
        "mapped_px": (stress.some or seen.stress) * world.plots_x,
        "stressed_px": stress.some * world.plots_x,
        "stressed_sensors": stress.some * world.sensors,
        "winds": config.wind.some * (world.steps + 1),
        "sides": sum(config.zones.corners),
        "zones": len(config.zones.corners),
        "ways": ways,
        "closing": len(numbers.ways.goal_start) - 1,
        "pairs": numbers.plans.pairs,
    }


def make_state(config: FarmConfig, numbers: Constants, environments: int, hindsight: bool) -> Farm:
    """Allocate the environments, and what tracks visits if `hindsight` is set."""
    state = make_record(Farm, axis_sizes(config, numbers, hindsight), (environments,))
    state.time[:], state.cycle[:] = -1, 1
    return state


def make_scratch(config: FarmConfig, numbers: Constants) -> Scratch:
    """Allocate the working memory of one environment's step."""
    world, sizes = config.world, axis_sizes(config, numbers, hindsight=False)
    return make_record(
        Scratch,
        sizes,
        assigning=make_record(AssignmentScratch, sizes, exchanges=make_record(Exchanges, sizes)),
        added=make_view_scratch(config),
        plot_plan=make_plan_scratch(numbers.plans, world.plots_x * world.plots_y),
        sensor_plan=make_plan_scratch(numbers.plans, world.sensors),
    )
