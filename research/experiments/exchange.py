"""The reward of UAVs that search in a team of learned UAVs, and what the others still earn.

    python -m research.experiments.exchange [--farms 500:508] [--write research/results/exchange]

Of one type some UAVs are flown by the search of `horizon`, 16 steps ahead without a sweep, the others by the policy
that ships. Searches know of each other's plans, and nothing of what the learned UAVs are about to do. Where one search
earns more than the learned UAV did and the others lose as much, it takes from them; what a type earns all together
shows whether anything was gained.
"""

import argparse
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.farm import COLLECTION, MONITORING, farm_team
from eia_sec.common.team import Float32
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import episode_seed
from eia_sec.rollout.heuristics.composite import COLLECTORS, MONITORS, CompositePolicy, FarmState
from eia_sec.rollout.heuristics.relays import CentroidRelays
from eia_sec.rollout.heuristics.tasks import lawnmower
from eia_sec.rollout.heuristics.tasks.horizon import Effort, HorizonGroupPolicy
from eia_sec.rollout.policies import Policy, policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from research.experiments.reporting import farm_range, filled, write_results

TEMPLATE: Final = Path(__file__).with_suffix(".md")
LEARNED: Final = "trained:eia-sec"
"""The policy of all others."""
AHEAD: Final = 16
"""Steps that the search looks ahead, to the end of the episode."""
KINDS: Final = {MONITORING: MONITORS, COLLECTION: COLLECTORS}


class PartialGroupPolicy(HorizonGroupPolicy):
    """A group of which the first few search, one after the other; the rest have no plans and stay where they are.

    Args:
        state: the start.
        kind: the searchers's type.
        searching: how many search.
    """

    def __init__(self, state: FarmState, kind: int, searching: int) -> None:
        super().__init__(state, kind, Effort(horizon=AHEAD, last_horizon=AHEAD, last_width=32))
        self._searching = searching

    def goals(self, state: FarmState) -> NDArray[np.float64]:
        """Return the next place of each plan, [n_v, 2] m; the own place of those that have none."""
        self._plans = [plan[1:] for plan in self._plans]
        goals = state.of(self._kind).copy()
        for uav in range(self._searching):
            if state.time % len(self._plans) == uav or len(self._plans[uav]) == 0:
                self._plans[uav] = self._plan(state, uav)
            goals[uav] = self._grid.place[self._plans[uav][0]]
        return goals


class Exchange:
    """Flies one policy with some UAVs exchanged for those of another.

    Args:
        policy: flies all other UAVs.
        other: flies those that are exchanged.
        columns: their columns of an action.
    """

    def __init__(self, policy: Policy, other: Policy, columns: slice) -> None:
        self._policy, self._other, self._columns = policy, other, columns

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Prepare for the episode that environment `index` has just begun."""
        self._policy.reset(farms, index)
        self._other.reset(farms, index)

    def act(self, farms: FarmBatch) -> Float32:
        """Return the actions [E, A] of all agents."""
        action = self._policy.act(farms).copy()
        if self._columns.stop > self._columns.start:
            action[:, self._columns] = self._other.act(farms)[:, self._columns]
        return action


def searching_team(config: FarmConfig, kind: str, searching: int) -> Exchange:
    """Return the policy that ships with the first few of a type exchanged for searches."""
    searchers = partial(PartialGroupPolicy, kind=KINDS[kind], searching=searching)
    monitors = searchers if kind == MONITORING else lawnmower.monitors
    collectors = searchers if kind == COLLECTION else lawnmower.collectors
    search = CompositePolicy(config, CentroidRelays, monitors, collectors)
    first = farm_team(config).agent_slices()[KINDS[kind]].start
    return Exchange(policy_of(LEARNED, config), search, slice(2 * first, 2 * (first + searching)))


def fly(config: FarmConfig, kind: str, searching: int, farms: range) -> dict[str, Any]:
    """Return the mean reward of a type's UAVs: of those that search, of those that stay, and of all."""
    policy, agents, rewards = searching_team(config, kind, searching), farm_team(config).agent_slices()[KINDS[kind]], []
    for farm in farms:
        batch = FarmBatch(config, 1)
        batch.reset(0, farm, episode_seed(farm, 0))
        policy.reset(batch, 0)
        while not batch.ended.all():
            batch.step(policy.act(batch))
        rewards.append(batch.summary(0).reward[agents])
    own = np.array(rewards, np.float64)
    parts = {"search": own[:, :searching], "learned": own[:, searching:], "all": own}
    return {"type": kind, "searching": searching} | {
        name: round(float(part.mean()), 1) if part.size else None for name, part in parts.items()
    }


def page(data: dict[str, Any]) -> str:
    """Return the results as a page."""
    rows = [
        f"| {found['type']} | {found['searching']} | "
        + " | ".join("" if found[part] is None else f"{found[part]:.0f}" for part in ("search", "learned", "all"))
        + " |"
        for found in data["results"]
    ]
    return filled(TEMPLATE, data, ahead=AHEAD, rows="\n".join(rows))


def main() -> None:
    """Fly every exchange, print what came out, and write it where asked."""
    about = (__doc__ or "").partition("\n")[0]
    parser = argparse.ArgumentParser(prog="python -m research.experiments.exchange", description=about)
    parser.add_argument("--farms", type=farm_range, default="500:508", help="farm seeds A:B, from A to B - 1")
    parser.add_argument("--write", type=Path, help="folder for results.json and README.md")
    arguments = parser.parse_args()
    farms = arguments.farms
    config = PRESETS["eia-sec"].farm
    results = [fly(config, kind, searching, farms) for kind in KINDS for searching in (0, 1, 2, 3, 4)]
    data = {**provenance("research.experiments.exchange"), "farms": list(farms), "results": results}
    write_results(data, page, arguments.write)


if __name__ == "__main__":
    main()
