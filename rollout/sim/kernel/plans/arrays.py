"""The working memory of plans, allocated once."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.kernel.plans.constants import PlanConstants

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]
Site = NDArray[np.uint32]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


class PlanScratch(NamedTuple):
    """Working memory of the plans of a type that serves S sites, plots or sensors. W plans are kept.

    Attributes:
        due: [S] step at which each counter rises next, as far as the team knows.
        cycle: [S] steps from one rise to the next, as far as the team knows.
        owner: [S] UAV of the type that is nearest to each site.
        within: [S] sites that matter to the UAV that plans: its own, which it can reach, and which hold something or
            will. What follows knows them by their places in this list.
        own: [S] their counters.
        rising: [H, S] those whose counters rise in each step of a plan.
        risen: [H] how many they are.
        linked: [K] whether a UAV's work counts from over each of K lattice points, see `links`.
        first: [K + 1] where the sites that are served from each lattice point begin in `site`.
        site: [M] these sites.
        chance: [M] share of a site's counter that a step over the point serves.
        costs: [5] see `view.step_costs`.
        level: [2, W, S] counters as each plan leaves them, before and after a step.
        move: [2, W] its first move.
        end: [2, W] lattice point at which it ends.
        score: [2, W] what it is worth, in units.
        worth: [9] what a plan is worth with one step more, in units.
        to: [9] where it ends then.
        value: [W] worths of the best longer plans, in descending order.
        names: [W] their ends and first moves, see `search.MOVES`.
        parents: [W] the plans that they extend.
        chosen: [2, W] names and parents of the plans that are kept.
        best: [9] worth of the best plan of each first move, in units.
        lead: [2, 9] its name and its parent.
    """

    due: Int32
    cycle: Int32
    owner: Indices
    within: Indices
    own: Float32
    rising: Site
    risen: Indices
    linked: Flags
    first: Int32
    site: Site
    chance: Float32
    costs: Array
    level: Float32
    move: Indices
    end: Indices
    score: Array
    worth: Array
    to: Indices
    value: Array
    names: Indices
    parents: Indices
    chosen: Indices
    best: Array
    lead: Indices


def make_plan_scratch(plans: PlanConstants, sites: int) -> PlanScratch:
    """Allocate the working memory of plans over so many sites; without plans there is next to none."""
    steps, paths = plans.steps, plans.paths
    count = sites * (steps > 0)
    points = plans.columns * plans.rows * (steps > 0)
    return PlanScratch(
        due=np.zeros(count, np.int32),
        cycle=np.zeros(count, np.int32),
        owner=np.zeros(count, np.int64),
        within=np.zeros(count, np.int64),
        own=np.zeros(count, np.float32),
        rising=np.zeros((steps, count), np.uint32),
        risen=np.zeros(steps, np.int64),
        linked=np.ones(points, np.bool_),
        first=np.zeros(points + 1, np.int32),
        site=np.zeros(plans.most_pairs, np.uint32),
        chance=np.zeros(plans.most_pairs, np.float32),
        costs=np.zeros(5),
        level=np.zeros((2, paths, count), np.float32),
        move=np.zeros((2, paths), np.int64),
        end=np.zeros((2, paths), np.int64),
        score=np.zeros((2, paths)),
        worth=np.zeros(9),
        to=np.zeros(9, np.int64),
        value=np.zeros(paths),
        names=np.zeros(paths, np.int64),
        parents=np.zeros(paths, np.int64),
        chosen=np.zeros((2, paths), np.int64),
        best=np.zeros(9),
        lead=np.zeros((2, 9), np.int64),
    )
