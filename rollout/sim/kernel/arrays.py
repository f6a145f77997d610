"""The arrays of the compiled simulator."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.kernel.assignment.arrays import AssignmentScratch
from eia_sec.rollout.sim.kernel.constants import Array, Constants, Indices, Int32
from eia_sec.rollout.sim.kernel.plans.arrays import PlanScratch
from eia_sec.rollout.sim.kernel.views.arrays import ViewScratch

Float32 = NDArray[np.float32]
Flags = NDArray[np.bool_]
Site = NDArray[np.uint32]
Steps = NDArray[np.uint16]

REWARD_PARTS: Final = ("positioning", "energy", "risk", "boundary", "utility", "idle", "motivation", "relayed")
"""The weighted parts of a reward in storage order; the reward is their sum."""


class State(NamedTuple):
    """State of all environments [E]; UAVs [n] in row order.

    Attributes:
        key: [E] packet key of the episode, see `eia_sec.rollout.sim.batch.packet_key`.
        time: [E] steps done; -1 before the first reset.
        position: [E, n, 2] m.
        direction: [E, n, 2] current D_VDF and D_AoI.
        assignment: [E, n_m + n_d] relay of each served UAV.
        service: [E, n_c] D_c, m.
        sensor: [E, 2, S] sensor positions, m.
        cell_start: [E, cells + 1] first sensor of each cell.
        by_row: [E, S] the sensors row by row of cells.
        row_start: [E, cells + 1] where each cell's sensors begin in that list, row by row.
        cycle: [E, S] T_UA, steps.
        age: [E, S] AoI.
        age_due: [E, S] step at which AoI rises next.
        level: [E, n_px, n_py] VDF.
        level_due: [E, n_px, n_py] step at which VDF rises next.
        sweep: [E, n_m, 2] sweep route of each monitoring UAV and the box on it that comes next, see `views.routes`.
        observation: [E, O] observations.
        reward: [E, n] reward of the last step.
        parts: [E, n, K] reward parts of the last step.
        energy: [E, n] energy used in the last step, J.
        utility: [E, n] VMUF and DCUF of the last step.
        served: [E, n_d] sensors with AoI above 0 that delivered in the last step.
        returns: [E, n] sums of the episode's rewards so far.
        sums: [E, 5] sums over the episode's steps: mean AoI, mean VDF, crowded UAVs, UAVs outside, energy in J.
        rising: [E, 2] next step at which any AoI rises, and the same for VDF.
        age_below: [E, cells_y + 1, cells_x] tally of AoI over the sensor cells, see `spatial.tallies`.
        age_above: [E, cells_y + 1, cells_x] the tally's other table.
        waiting: [E, 1] number of sensors that hold data.
        level_below: [E, n_py + 1, n_px] tally of VDF over the plots.
        level_above: [E, n_py + 1, n_px] the tally's other table.
        listed: [E, n_d, observed sensors] sensors that each data collection UAV sees.
        quality: [E, n_m + n_d] signal-to-noise ratio of the link to the relay, dB.
        plot_visit: [E, P, 4] last visit of each plot, see `hindsight`; [E, 0, 4] unless visits are tracked.
        sensor_visit: [E, S, 4] the same of each sensor.
        failure: [E, n] first step of which each UAV is no part.
        gone: [E, n] whether each UAV has failed, see `failures`; the position of one that has is infinite.
        living: [E, 3] UAVs of each type that have not failed.
        shown: [E, n, 2] positions, of UAVs that have failed the last ones, m; [E, 0, 2] unless UAVs can fail.
        charge: [E, n] of the batteries, J.
        patch_place: [E, P, 2] centres of the patches of stress, m.
        patch_time: [E, P, 2] first step of each patch, and the first one without it.
        patch_known: [E, P] whether the team knows it.
        stressed: [E, n_px, n_py] 1 for plots in areas, and in living patches that are known; [E, 0, n_py] if there is
            no stress.
        plot_cycle: [E, 3, n_px, n_py] present cycle and phase of each plot's VDF, and its growth because of areas;
            [E, 3, 0, n_py] without stress.
        sensor_cycle: [E, 3, S] cycle without stress and phase of each sensor's AoI, and its growth because of areas;
            [E, 3, 0] without stress.
        wind: [E, T + 1, 2] wind of each step, m/s; [E, 0, 2] without wind.
        zone_side: [E, K, 4] sides of the no-fly zones, see `flight.airspace`.
        zone_box: [E, Z, 4] boxes around them.
        barred: [E, K] barred steps from each lattice point, see `flight.ways`; [E, 0] if nothing leads round zones.
        closed: [E, P] whether zones shut each plot off; [E, 0] without zones or sweep routes.
        plan_first: [E, S + 1] where the lattice points of each sensor begin in `plan_point`.
        plan_point: [E, M] lattice points at which a sensor is heard, see `plans.places`; [E, 0] without plans.
        plan_chance: [E, M] probability that its packets arrive there.
        hindsight: [E, T, n] corrections of the episode's rewards; [E, 0, n] unless visits are tracked.
    """

    key: NDArray[np.uint64]
    time: Indices
    position: Array
    direction: Array
    assignment: Indices
    service: Array
    sensor: Array
    cell_start: Int32
    by_row: Int32
    row_start: Int32
    cycle: Int32
    age: Array
    age_due: Int32
    level: Array
    level_due: Int32
    sweep: Int32
    observation: Float32
    reward: Float32
    parts: Array
    energy: Array
    utility: Array
    served: Array
    returns: Array
    sums: Array
    rising: Indices
    age_below: Array
    age_above: Array
    waiting: Indices
    level_below: Array
    level_above: Array
    listed: Indices
    quality: Array
    plot_visit: Int32
    sensor_visit: Int32
    failure: Int32
    gone: Flags
    living: Indices
    shown: Array
    charge: Array
    patch_place: Array
    patch_time: Int32
    patch_known: Flags
    stressed: Array
    plot_cycle: Int32
    sensor_cycle: Int32
    wind: Array
    zone_side: Array
    zone_box: Array
    barred: Steps
    closed: Flags
    plan_first: Int32
    plan_point: Site
    plan_chance: Float32
    hindsight: Float32


class Farm(NamedTuple):
    """State of one environment: the arrays of `State` without their first axis; `step` is its `time`."""

    key: np.uint64
    step: int
    position: Array
    direction: Array
    assignment: Indices
    service: Array
    sensor: Array
    cell_start: Int32
    by_row: Int32
    row_start: Int32
    cycle: Int32
    age: Array
    age_due: Int32
    level: Array
    level_due: Int32
    sweep: Int32
    observation: Float32
    reward: Float32
    parts: Array
    energy: Array
    utility: Array
    served: Array
    returns: Array
    sums: Array
    rising: Indices
    age_below: Array
    age_above: Array
    waiting: Indices
    level_below: Array
    level_above: Array
    listed: Indices
    quality: Array
    plot_visit: Int32
    sensor_visit: Int32
    failure: Int32
    gone: Flags
    living: Indices
    shown: Array
    charge: Array
    patch_place: Array
    patch_time: Int32
    patch_known: Flags
    stressed: Array
    plot_cycle: Int32
    sensor_cycle: Int32
    wind: Array
    zone_side: Array
    zone_box: Array
    barred: Steps
    closed: Flags
    plan_first: Int32
    plan_point: Site
    plan_chance: Float32
    hindsight: Float32


class Scratch(NamedTuple):
    """Working memory of one environment's step.

    Attributes:
        previous: [n, 2] positions before the step, m.
        outside: [n] ACT.
        motivated: [n] M_V or M_D.
        neighbour: [n] nearest UAV.
        distance: [n] d_U, m.
        crowded: [n] whether another UAV of the plane is closer than the collision distance.
        linked: [n_m + n_d] whether the UAV's relay is in range, and joined if there is a base station.
        joined: [n_c] whether each relay is joined to the base station, see `chain`.
        joined_then: [n_c] the same if one relay stood elsewhere.
        queue: [n_c] relays that are joined.
        earlier: [n_c] D_c(k-1), m.
        centroid: [n_c + 1, 3] centroids of the served UAVs; the last row is that of all relays, m.
        farthest: [n_c] farthest UAV served.
        number: [n_c] number of UAVs served.
        far: [n_c] distance of the farthest UAV, m.
        peer: [n] nearest UAV of the plane.
        apart_square: [n] square of its distance, m^2.
        x: [n] positions along x, m.
        y: [n] positions along y, m.
        around: [S + 1] sensors around a UAV; the last entry is never read.
        square: [S + 1] squares of their distances, m^2.
        nearest_square: [observed sensors] squares of the distances of the nearest, m^2.
        woken: [n_d] strongest sensor that each UAV wakes.
        power: [n_d] interference, mW.
        way_steps: [K] steps of ways round zones, see `flight.ways`.
        way_queue: [K] lattice points of these ways.
        item: [max(S, P)] sensors or plots served.
        share: [S] shares delivered.
        assigning: working memory of the assignment.
        added: working memory of the added observations.
        plot_plan: working memory of the monitoring UAVs' plans.
        sensor_plan: working memory of the data collection UAVs' plans.
    """

    previous: Array
    outside: Array
    motivated: Array
    neighbour: Indices
    distance: Array
    crowded: Array
    linked: Array
    joined: Flags
    joined_then: Flags
    queue: Indices
    earlier: Array
    centroid: Array
    farthest: Indices
    number: Array
    far: Array
    peer: Indices
    apart_square: Array
    x: Array
    y: Array
    around: Indices
    square: Array
    nearest_square: Array
    woken: Indices
    power: Array
    way_steps: Int32
    way_queue: Int32
    item: Indices
    share: Array
    assigning: AssignmentScratch
    added: ViewScratch
    plot_plan: PlanScratch
    sensor_plan: PlanScratch


class Workspace(NamedTuple):
    """All data that one thread works with.

    Attributes:
        constants: numbers derived from the configuration.
        state: the environments, which all threads share.
        scratch: working memory of this thread.
        action: [E, 2 n] actions of the next step.
    """

    constants: Constants
    state: State
    scratch: Scratch
    action: Float32
