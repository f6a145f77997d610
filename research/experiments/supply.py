"""Where the supply goes: units that a policy is paid for, that are left at the end, and that are lost for good.

    python -m research.experiments.supply [POLICY ...] [--farms 1000:1020] [--write research/results/supply]

Every counter rises at multiples of its cycle and no further than its largest value (W18). A unit that has risen is paid
for, or is left at the end of the episode. A rise that does not happen is lost: at the cap, because nobody came for so
long, or else to service, because the counter is set back in the very step in which it was to rise.
"""

import argparse
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import ConfigError
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import episode_seed
from eia_sec.rollout.policies import Policy, policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from research.experiments.reporting import farm_range, filled, write_results

TEMPLATE: Final = Path(__file__).with_suffix(".md")
POLICIES: Final = ("trained:eia-sec", "lawnmower", "greedy", "hungarian", "tour", "horizon")
PLOTS: Final = "VDF of plots"
KINDS: Final = (PLOTS, "AoI of sensors")
COLUMNS: Final = ("supply", "paid", "left", "service", "cap", "border")

Array = NDArray[np.float64]


class SupplyLog:
    """Follows the counters of one farm, all plots or all sensors, through an episode.

    Args:
        cycle: steps between two rises of each counter; rises are at multiples of it.
        largest: the largest value of a counter.
        border: which counters stand at the field's border.
    """

    def __init__(self, cycle: Array, largest: float, border: NDArray[np.bool_]) -> None:
        self._cycle, self._largest, self._border = cycle, largest, border
        self._before = np.zeros(cycle.shape)
        self._supply = self._paid = self._cap = self._lost_at_border = 0.0

    def note(self, step: int, level: Array, paid: float) -> None:
        """Take down one step: its number from 1 on, the counters behind it, and the units that it paid."""
        due = step % self._cycle == 0
        lost = due & (self._before >= self._largest)
        self._supply += float(due.sum())
        self._paid += paid
        self._cap += float(lost.sum())
        self._lost_at_border += float((lost & self._border).sum())
        self._before = level.copy()

    def totals(self) -> dict[str, float]:
        """Return the units by the names of COLUMNS; `border` is the part of `cap` that was lost there."""
        left = float(self._before.sum())
        service = self._supply - self._paid - self._cap - left
        found = self._supply, self._paid, left, service, self._cap, self._lost_at_border
        return dict(zip(COLUMNS, found, strict=True))


def follow(config: FarmConfig, policy: Policy, farm: int) -> dict[str, dict[str, float]]:
    """Fly the first episode of a farm; return what became of the supply, by the names of KINDS.

    Raises:
        ConfigError: counters begin otherwise than at 0.
    """
    world, batch = config.world, FarmBatch(config, 1)
    if world.start_levels != "zero":
        raise ConfigError("the supply is counted for counters that start at 0.")
    batch.reset(0, farm, episode_seed(farm, 0))
    policy.reset(batch, 0)
    border = np.ones((world.plots_x, world.plots_y), bool)
    border[1:-1, 1:-1] = False
    cycles = np.asarray(batch.layout(0).sensor_cycle_steps, np.float64)
    plots = SupplyLog(np.full(border.shape, round(world.vdf_cycle / world.step_seconds), float), world.vdf_max, border)
    sensors = SupplyLog(cycles, world.aoi_max, np.zeros(len(cycles), bool))
    first, last = world.communication_uavs, world.communication_uavs + world.monitoring_uavs
    for step in range(1, world.steps + 1):
        batch.step(policy.act(batch))
        paid = batch.utility[0]
        plots.note(step, batch.vdf[0], float(paid[first:last].sum()))
        sensors.note(step, batch.aoi[0], float(paid[last:].sum()))
    return dict(zip(KINDS, (plots.totals(), sensors.totals()), strict=True))


def mean(config: FarmConfig, name: str, farms: range) -> dict[str, Any]:
    """Return what became of the supply with a policy, means over farms."""
    policy = policy_of(name, config)
    flown = [follow(config, policy, farm) for farm in farms]
    return {"policy": name} | {
        kind: {column: round(float(np.mean([totals[kind][column] for totals in flown])), 1) for column in COLUMNS}
        for kind in KINDS
    }


def page(data: dict[str, Any]) -> str:
    """Return the results as a page."""
    tables: list[str] = []
    for kind in KINDS:
        tables += [
            "",
            f"## {kind}",
            "",
            "| policy | supply | paid | left at the end | lost to service | lost at the cap |",
        ]
        tables.append("|---|---:|---:|---:|---:|---:|")
        for found in data["results"]:
            own = found[kind]
            border = f" ({own['border']:.0f})" if kind == PLOTS else ""
            numbers = " | ".join(f"{own[column]:,.0f}" for column in ("supply", "paid", "left", "service", "cap"))
            tables.append(f"| {found['policy']} | {numbers}{border} |")
    return filled(TEMPLATE, data, tables="\n".join(tables))


def main() -> None:
    """Fly every policy, print what came out, and write it where asked."""
    about = (__doc__ or "").partition("\n")[0]
    parser = argparse.ArgumentParser(prog="python -m research.experiments.supply", description=about)
    parser.add_argument("policy", nargs="*", default=list(POLICIES), help="policies by name or file")
    parser.add_argument("--farms", type=farm_range, default="1000:1020", help="farm seeds A:B, from A to B - 1")
    parser.add_argument("--write", type=Path, help="folder for results.json and README.md")
    arguments = parser.parse_args()
    farms = arguments.farms
    config = PRESETS["eia-sec"].farm
    results = [mean(config, name, farms) for name in arguments.policy]
    data = {**provenance("research.experiments.supply"), "farms": list(farms), "results": results}
    write_results(data, page, arguments.write)


if __name__ == "__main__":
    main()
