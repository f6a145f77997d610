"""Record a chunk of real experience of a wanted size, for players to play."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.transitions import Chunk
from eia_sec.rollout.worker.collector import Collector
from research.benchmarks.intake.chunks import NAMES

ENVIRONMENTS = 4


def configuration(size: int) -> RunConfig:
    """Return the run on the default farm whose chunks have about `size` bytes of observations, actions and rewards."""
    team = farm_team(preset("study").farm)
    row = 4 * (team.observation_size + team.action_size + team.agents)
    environments = ENVIRONMENTS if size >= 8 * ENVIRONMENTS * row else 1
    steps = max(1, round(size / row / environments) - 1)
    config = preset("study")
    return replace(config, rollout=replace(config.rollout, environments=environments, chunk_steps=steps))


def record(size: int) -> Chunk:
    """Return a chunk of the run of `configuration`, flown with random actions."""
    config = configuration(size)
    actors = TeamActors.initial(farm_team(preset("study").farm), config.algorithm.hidden, 0)
    return Collector(config, "recorder", 0).collect(actors, 0.0, uniform=True)


def write(chunk: Chunk, folder: Path) -> None:
    """Write a chunk's arrays for the peers."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays = {name: getattr(chunk.rows, name) for name in NAMES}
    for name, array in arrays.items():
        np.ascontiguousarray(array).tofile(folder / f"{name}.f4")
    shapes = {name: list(array.shape) for name, array in arrays.items()} | {"steps": chunk.rows.steps}
    (folder / "shapes.json").write_text(json.dumps(shapes), encoding="utf-8")
