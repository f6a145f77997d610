"""What plans reckon with: how counters will rise, as far as the team knows, and whose each site is."""

import math

from eia_sec.rollout.sim.conditions.failures import NEVER
from eia_sec.rollout.sim.conditions.stress import is_known, next_due, shortened
from eia_sec.rollout.sim.core.arrays import Farm
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.records import Array, Float32, Int32, Site
from eia_sec.rollout.sim.observation.plans.arrays import PlanScratch


@inlined
def know_plots(c: Constants, farm: Farm, plan: PlanScratch) -> None:
    """Write when each plot's VDF rises next, and how often; patches of stress that nobody has found count as none."""
    camera, step = c.camera, farm.time[0]
    for site in range(len(plan.due)):
        column, row = site // camera.plots_y, site % camera.plots_y
        if c.stress.some:
            x, y = (column + 0.5) * camera.plot_width, (row + 0.5) * camera.plot_depth
            known = is_known(
                farm.patch_place, farm.patch_time, farm.patch_known, c.stress.radius * c.stress.radius, step, x, y
            )
            cycle = shortened(camera.cycle, farm.plot_cycle[1, column, row], c.stress.growth, known)
            cycle = min(cycle, NEVER)
            plan.due[site], plan.cycle[site] = next_due(step + 1, cycle), cycle
        else:
            plan.due[site], plan.cycle[site] = farm.level_due[column, row], min(camera.cycle, NEVER)


@inlined
def know_sensors(c: Constants, farm: Farm, plan: PlanScratch) -> None:
    """Write when each sensor's AoI rises next, and how often; patches of stress that nobody has found count as none."""
    step = farm.time[0]
    for site in range(len(plan.due)):
        if c.stress.some:
            x, y, usual = farm.sensor[0, site], farm.sensor[1, site], farm.sensor_cycle
            known = is_known(
                farm.patch_place, farm.patch_time, farm.patch_known, c.stress.radius * c.stress.radius, step, x, y
            )
            cycle = shortened(usual[0, site], usual[1, site], c.stress.growth, known)
            plan.due[site], plan.cycle[site] = next_due(step + 1, cycle), cycle
        else:
            plan.due[site], plan.cycle[site] = farm.age_due[site], farm.cycle[site]


@allocation_free
def find_owners(position: Array, first: int, last: int, x: Array, y: Array, plan: PlanScratch) -> None:
    """Find the UAV that is nearest to each site; ties go to the lowest index.

    Args:
        position: [n, 2] m.
        first: first UAV of the type.
        last: one past the last.
        x: [S] of each site, m.
        y: [S] the same along y, m.
        plan: the function writes `owner`.
    """
    for site in range(len(x)):
        least, owner = math.inf, first
        for u in range(first, last):
            dx, dy = x[site] - position[u, 0], y[site] - position[u, 1]
            square = dx * dx + dy * dy
            if square < least:
                least, owner = square, u
        plan.owner[site] = owner


@allocation_free
def find_sites(
    u: int,
    x: float,
    y: float,
    wide: float,
    deep: float,
    now: int,
    level: Array,
    site_x: Array,
    site_y: Array,
    plan: PlanScratch,
) -> int:
    """List the sites that matter to a UAV, their counters, and which of them rise in each step; return how many.

    Args:
        u: the UAV.
        x: of it, m.
        y: of it, m.
        wide: distance along x within which it can serve sites, m.
        deep: the same along y, m.
        now: steps done.
        level: [S] counters.
        site_x: [S] of each site, m.
        site_y: [S] the same along y, m.
        plan: `due`, `cycle` and `owner`; the function writes `within`, `own`, `rising` and `risen`.
    """
    steps, found = len(plan.risen), 0
    plan.risen[:] = 0
    for site in range(len(level)):
        due = plan.due[site] - now - 1
        matters = plan.owner[site] == u and (level[site] > 0.0 or due < steps)
        if not matters or abs(site_x[site] - x) > wide or abs(site_y[site] - y) > deep:
            continue
        plan.within[found], plan.own[found] = site, level[site]
        while due < steps:
            plan.rising[due, plan.risen[due]] = found
            plan.risen[due] += 1
            due += plan.cycle[site]
        found += 1
    return found


@allocation_free
def sort_by_point(found: int, first: Int32, point: Site, chance: Float32, plan: PlanScratch) -> None:
    """List the sites that are served from each lattice point, in ascending order, from the points of each site.

    None is served from points without a link.

    Args:
        found: sites that matter.
        first: [S + 1] where the lattice points of each site begin in `point`.
        point: [M] lattice points.
        chance: [M] share of a site's counter that a step over the point serves.
        plan: `within` and `linked`; the function writes `first`, `site` and `chance`.
    """
    start = plan.first
    start[:] = 0
    for k in range(found):
        for entry in range(first[plan.within[k]], first[plan.within[k] + 1]):
            start[point[entry]] += 1 if plan.linked[point[entry]] else 0
    total = 0
    for place in range(len(start)):
        total += start[place]
        start[place] = total
    for k in range(found - 1, -1, -1):
        for entry in range(first[plan.within[k]], first[plan.within[k] + 1]):
            if plan.linked[point[entry]]:
                start[point[entry]] -= 1
                at = start[point[entry]]
                plan.site[at], plan.chance[at] = k, chance[entry]
