"""The working memory of plans."""

from typing import Annotated, NamedTuple

from eia_sec.rollout.sim.core.records import Array, Flags, Float32, Indices, Int32, Site, make_record
from eia_sec.rollout.sim.observation.plans.constants import PlanConstants


class PlanScratch(NamedTuple):
    """Working memory of the plans of a type that serves sites, plots or sensors, over the lattice's points."""

    due: Annotated[Int32, "sites", "step at which each counter rises next, as far as the team knows"]
    cycle: Annotated[Int32, "sites", "steps from one rise to the next, as far as the team knows"]
    owner: Annotated[Indices, "sites", "UAV of the type that is nearest to each site"]
    within: Annotated[
        Indices,
        "sites",
        "sites that matter to the UAV that plans: its own, which it can reach, and which hold something or "
        "will. What follows knows them by their places in this list",
    ]
    own: Annotated[Float32, "sites", "their counters"]
    rising: Annotated[Site, "steps sites", "those whose counters rise in each step of a plan"]
    risen: Annotated[Indices, "steps", "how many they are"]
    linked: Annotated[Flags, "points", "whether a UAV's work counts from over each of K lattice points, see `links`"]
    first: Annotated[Int32, "points+1", "where the sites that are served from each lattice point begin in `site`"]
    site: Annotated[Site, "pairs", "these sites"]
    chance: Annotated[Float32, "pairs", "share of a site's counter that a step over the point serves"]
    costs: Annotated[Array, "5", "see `view.step_costs`"]
    level: Annotated[Float32, "2 paths sites", "counters as each plan leaves them, before and after a step"]
    move: Annotated[Indices, "2 paths", "its first move"]
    end: Annotated[Indices, "2 paths", "lattice point at which it ends"]
    score: Annotated[Array, "2 paths", "what it is worth, in units"]
    worth: Annotated[Array, "9", "what a plan is worth with one step more, in units"]
    to: Annotated[Indices, "9", "where it ends then"]
    value: Annotated[Array, "paths", "worths of the best longer plans, in descending order"]
    names: Annotated[Indices, "paths", "their ends and first moves, see `search.MOVES`"]
    parents: Annotated[Indices, "paths", "the plans that they extend"]
    chosen: Annotated[Indices, "2 paths", "names and parents of the plans that are kept"]
    best: Annotated[Array, "9", "worth of the best plan of each first move, in units"]
    lead: Annotated[Indices, "2 9", "its name and its parent"]


def make_plan_scratch(plans: PlanConstants, sites: int) -> PlanScratch:
    """Allocate the working memory of plans over so many sites; without plans there is next to none."""
    some = plans.steps > 0
    sizes = {"sites": sites * some, "points": plans.columns * plans.rows * some, "pairs": plans.most_pairs}
    plan = make_record(PlanScratch, sizes | {"steps": plans.steps, "paths": plans.paths})
    plan.linked[:] = True
    return plan
