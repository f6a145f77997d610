"""The picture and the tables of docs/reference/environment.md."""

import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import matplotlib.image
import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FailureConfig, FarmConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.farm_observation import TYPES, Part, observation_parts
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.rendering.render import Renderer
from eia_sec.rollout.shipped_policies import preset_of
from eia_sec.rollout.sim.batch import FarmBatch
from research.pages.blocks import Block
from research.pages.measurements import measured

TIMINGS: Final = Path("research/results/environment.json")
POLICY: Final = "tour"
"""A heuristic: matrix products of actors round differently on other processors, and a flight shows it after a while."""
FARM: Final = 1000
EPISODE: Final = 0
STEP: Final = 205
"""The step that the picture shows; VDF has risen a few times by then."""


def draw_farm(path: Path) -> None:
    """Draw the picture into a file."""
    matplotlib.image.imsave(path, picture())


def picture() -> NDArray[np.uint8]:
    """Return the policy POLICY on farm FARM after STEP steps, [H, W, 3]."""
    batch = FarmBatch(preset(preset_of(POLICY)).farm, 1)
    policy, renderer = policy_of(POLICY, batch.config), Renderer(batch, 0)
    batch.reset(0, FARM, EPISODE)
    policy.reset(batch, 0)
    renderer.observe()
    for _ in range(STEP):
        batch.step(policy.act(batch))
        renderer.observe()
    pixels: NDArray[np.uint8] = renderer.render("rgb_array")
    return pixels


HEAD: Final = "| agents | observation | numbers | from | to | meaning | when |\n|---|---|---:|---:|---:|---|---|"


def spaces_table(config: FarmConfig) -> str:
    """Return one table row for each part of each type's observation."""
    lines = [HEAD]
    for group in farm_team(config).groups:
        label = f"`{group.name}_0` .. `_{group.count - 1}`, {group.observation_size} numbers"
        lines += _rows(label, observation_parts(config, group.name))
    return "\n".join(lines) + "\n"


def added_table() -> str:
    """Return one table row for each part of the observations that options add, all of them on."""
    farm = preset("study").farm
    switches = ("last_move", "closing", "fields", "coarse", "phases", "route", "service", "link", "stress", "charge")
    on = dict.fromkeys((*switches, "wind", "zones"), True)
    seen = replace(farm.observation, peers=3, units=2, plan=12, **on)
    chained = replace(farm.relay, require_link=True, base="south")
    more = replace(farm, observation=seen, failures=FailureConfig(per_hour=1.0), relay=chained)
    lines = [HEAD]
    for name in TYPES:
        there = {part.names for part in observation_parts(farm, name)}
        added = [part for part in observation_parts(more, name) if part.names not in there]
        lines += _rows(f"`{name}`, {sum(part.size for part in added)} numbers", added)
    return "\n".join(lines) + "\n"


def _rows(label: str, parts: Sequence[Part]) -> Iterator[str]:
    """Yield a row for each part; those of a block that repeats (one for each sensor) once with their number."""
    for name, group in itertools.groupby(parts, key=lambda part: part.label):
        block = [(part.size, part.low, part.high, part.meaning, part.when) for part in group]
        kinds = list(dict.fromkeys(block))
        times = len(block) // len(kinds) if block == kinds * (len(block) // len(kinds)) else 1
        for size, low, high, meaning, when in kinds:
            what, numbers = (f"each {name}", f"{times} x {size}") if times > 1 else (name, str(size))
            by = f"`{when}`" if when.isidentifier() else when
            yield f"| {label} | {what} | {numbers} | {low:.7g} | {high:.7g} | {meaning} | {by} |"
            label = ""


def timings(root: Path) -> str:
    """Return what the interfaces cost, as measured."""
    data: dict[str, Any] = json.loads((root / TIMINGS).read_text(encoding="utf-8"))
    lines = [
        "| interface | farms | simulator alone, µs | through the interface, µs | ratio |",
        "|---|---:|---:|---:|---:|",
    ]
    rows = [("FarmVectorEnv", row["environments"], row) for row in data["vector"]]
    rows.append(("ParallelEnv, infos included", 1, data["parallel"]))
    for name, farms, row in rows:
        lines.append(
            f"| {name} | {farms} | {row['simulator_us']:,.0f} | {row['interface_us']:,.0f} | {row['ratio']:.2f} |"
        )
    return (
        f"`{data['command']}`, one core that other work shared:\n\n" + "\n".join(lines) + "\n\n"
        f"Pictures: {data['pictures_per_second']:.0f} a second.\n"
    )


BLOCKS: Final[Mapping[str, Block]] = {
    "spaces": lambda _: spaces_table(preset("study").farm),
    "added": lambda _: added_table(),
    "timings": timings,
    "inertia": partial(measured, "inertia"),
}
"""Every block of the page by its name."""
