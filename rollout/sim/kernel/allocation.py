"""The arrays of the compiled simulator, each allocated once."""

from typing import Any

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import farm_team
from eia_sec.rollout.sim.kernel.arrays import REWARD_PARTS, Scratch, State
from eia_sec.rollout.sim.kernel.assignment.arrays import make_assignment_scratch
from eia_sec.rollout.sim.kernel.constants import Constants
from eia_sec.rollout.sim.kernel.plans.arrays import make_plan_scratch
from eia_sec.rollout.sim.kernel.views.arrays import make_view_scratch
from eia_sec.rollout.sim.layout import cell_counts


def make_state(config: FarmConfig, numbers: Constants, environments: int, hindsight: bool) -> State:
    """Allocate the environments, and what tracks visits if `hindsight` is set."""
    world, team = config.world, farm_team(config)
    count, uavs, sensors = environments, world.uavs, world.sensors
    plots, served = (world.plots_x, world.plots_y), world.monitoring_uavs + world.collection_uavs
    stress, (columns, rows) = config.stress, cell_counts(world)
    return State(
        key=np.zeros(count, np.uint64),
        time=np.full(count, -1, np.int64),
        position=np.zeros((count, uavs, 2)),
        direction=np.zeros((count, uavs, 2)),
        assignment=np.zeros((count, served), np.int64),
        service=np.zeros((count, world.communication_uavs)),
        sensor=np.zeros((count, 2, sensors)),
        cell_start=np.zeros((count, columns * rows + 1), np.int32),
        by_row=np.zeros((count, sensors), np.int32),
        row_start=np.zeros((count, columns * rows + 1), np.int32),
        cycle=np.ones((count, sensors), np.int32),
        age=np.zeros((count, sensors)),
        age_due=np.zeros((count, sensors), np.int32),
        level=np.zeros((count, *plots)),
        level_due=np.zeros((count, *plots), np.int32),
        sweep=np.zeros((count, world.monitoring_uavs, 2), np.int32),
        observation=np.zeros((count, team.observation_size), np.float32),
        reward=np.zeros((count, uavs), np.float32),
        parts=np.zeros((count, uavs, len(REWARD_PARTS))),
        energy=np.zeros((count, uavs)),
        utility=np.zeros((count, uavs)),
        served=np.zeros((count, world.collection_uavs)),
        returns=np.zeros((count, uavs)),
        sums=np.zeros((count, 5)),
        rising=np.zeros((count, 2), np.int64),
        age_below=np.zeros((count, rows + 1, columns)),
        age_above=np.zeros((count, rows + 1, columns)),
        waiting=np.zeros((count, 1), np.int64),
        level_below=np.zeros((count, world.plots_y + 1, world.plots_x)),
        level_above=np.zeros((count, world.plots_y + 1, world.plots_x)),
        listed=np.zeros((count, world.collection_uavs, config.observation.sensors), np.int64),
        quality=np.zeros((count, served)),
        plot_visit=np.zeros((count, hindsight * world.plots_x * world.plots_y, 4), np.int32),
        sensor_visit=np.zeros((count, hindsight * sensors, 4), np.int32),
        failure=np.zeros((count, uavs), np.int32),
        gone=np.zeros((count, uavs), np.bool_),
        living=np.zeros((count, 3), np.int64),
        shown=np.zeros((count, config.loses_uavs * uavs, 2)),
        charge=np.zeros((count, config.battery.some * uavs)),
        patch_place=np.zeros((count, stress.patches, 2)),
        patch_time=np.zeros((count, stress.patches, 2), np.int32),
        patch_known=np.zeros((count, stress.patches), np.bool_),
        stressed=np.zeros((count, (stress.some or config.observation.stress) * world.plots_x, world.plots_y)),
        plot_cycle=np.zeros((count, 3, stress.some * world.plots_x, world.plots_y), np.int32),
        sensor_cycle=np.zeros((count, 3, stress.some * sensors), np.int32),
        wind=np.zeros((count, config.wind.some * (world.steps + 1), 2)),
        plan_first=np.zeros((count, sensors + 1), np.int32),
        plan_point=np.zeros((count, numbers.plans.pairs), np.uint32),
        plan_chance=np.zeros((count, numbers.plans.pairs), np.float32),
        **_zones(config, numbers, count),
        hindsight=np.zeros((count, hindsight * world.steps, uavs), np.float32),
    )


def _zones(config: FarmConfig, numbers: Constants, count: int) -> dict[str, Any]:
    """Allocate no-fly zones and the ways round them."""
    points, plots = numbers.ways.columns * numbers.ways.rows, len(numbers.ways.goal_start) - 1
    return {
        "zone_side": np.zeros((count, sum(config.zones.corners), 4)),
        "zone_box": np.zeros((count, len(config.zones.corners), 4)),
        "barred": np.zeros((count, points), np.uint16),
        "closed": np.zeros((count, plots), np.bool_),
    }


def make_scratch(config: FarmConfig, numbers: Constants) -> Scratch:
    """Allocate the working memory of one environment's step."""
    world = config.world
    uavs, sensors, collectors = world.uavs, world.sensors, world.collection_uavs
    served = world.monitoring_uavs + collectors
    relays = world.communication_uavs
    places = relays * config.relay.capacity_for(world)
    if config.loses_uavs:
        places = max(places, served + relays - 1)  # a living relay may serve more, see `capacity_left`
    return Scratch(
        previous=np.zeros((uavs, 2)),
        outside=np.zeros(uavs),
        motivated=np.zeros(uavs),
        neighbour=np.zeros(uavs, np.int64),
        distance=np.zeros(uavs),
        crowded=np.zeros(uavs),
        linked=np.zeros(served),
        joined=np.zeros(relays, np.bool_),
        joined_then=np.zeros(relays, np.bool_),
        queue=np.zeros(relays, np.int64),
        earlier=np.zeros(relays),
        centroid=np.zeros((relays + 1, 3)),
        farthest=np.zeros(relays, np.int64),
        number=np.zeros(relays),
        far=np.zeros(relays),
        apart_square=np.zeros(uavs),
        peer=np.zeros(uavs, np.int64),
        x=np.zeros(uavs),
        y=np.zeros(uavs),
        around=np.zeros(sensors + 1, np.int64),
        square=np.zeros(sensors + 1),
        nearest_square=np.zeros(config.observation.sensors),
        woken=np.zeros(collectors, np.int64),
        power=np.zeros(collectors),
        way_steps=np.zeros(numbers.ways.columns * numbers.ways.rows, np.int32),
        way_queue=np.zeros(numbers.ways.columns * numbers.ways.rows, np.int32),
        item=np.zeros(max(sensors, world.plots_x * world.plots_y), np.int64),
        share=np.zeros(sensors),
        assigning=make_assignment_scratch(served, relays, places),
        added=make_view_scratch(config),
        plot_plan=make_plan_scratch(numbers.plans, world.plots_x * world.plots_y),
        sensor_plan=make_plan_scratch(numbers.plans, sensors),
    )
