"""A scale of the studies so small that a run takes about a second."""

from collections.abc import Mapping, Sequence
from typing import Any

from eia_sec.common.farm import METRIC_NAMES
from eia_sec.common.process import StopSignal
from research.studies.jobs import Job
from research.studies.perform import perform
from research.studies.record_checks import COUNTERS
from research.studies.runner import Runner
from research.studies.scales import Scale

FARM = """
[farm.world]
field_x = 120.0
field_y = 120.0
sensors = 30
sensor_spacing = 5.0
plots_x = 6
plots_y = 6
steps = 40
[farm.observation]
sensors = 4
"""
SETTINGS = f"""{FARM}
[algorithm]
hidden = 16
batch = 32
[elite]
cycle = 2
farms = 2
[replay]
capacity = 4096
warmup_steps = 64
updates_per_step = 0.25
[rollout]
environments = 2
chunk_steps = 10
"""

ON_POLICY = f"""
episodes = 12
{FARM}
[algorithm]
hidden = 16
iteration_steps = 80
minibatch_steps = 20
[rollout]
environments = 2
chunk_steps = 40
"""

TINY = Scale(
    name="smoke",
    settings=SETTINGS,
    on_policy=ON_POLICY,
    episodes=12,
    seeds=2,
    side_seeds=1,
    team_seeds=1,
    view_seeds=1,
    trial_episodes=8,
    long_trial_episodes=10,
    candidates=2,
    farms=3,
    left_out=1,
    choice_farms=2,
    points=4,
    evaluations=2,
    members=(1, 2),
    uavs=(6, 12),
    timed_uavs=(6, 12),
    timed_steps=20,
    timed_seeds=1,
    heuristics=("greedy", "lawnmower"),
    flights=1,
)

TIMES = {piece: {"q05": 1.0, "median": 2.0, "mean": 2.5, "q95": 4.0} for piece in ("decide", "separate", "simulate")}
"""A result of a timing."""


def flown(first: int, rewards: Sequence[float]) -> dict[str, Any]:
    """Return the result of a flight with these rewards, and a hundredth of them as its metrics."""
    metrics = {key: [reward / 100.0 for reward in rewards] for key in METRIC_NAMES}
    types = {key: list(rewards) for key in ("communication", "monitoring", "collection")}
    return {"first_farm": first, "farms": len(rewards), "reward": list(rewards), "types": types, "metrics": metrics}


def trained(first: int, rewards: Sequence[float]) -> dict[str, Any]:
    """Return the result of a training whose policy earned these rewards."""
    parts = ("mean", "communication", "monitoring", "collection")
    return {
        "diverged": False,
        "curve": {"episodes": [6], "reward": {part: [1.0] for part in parts}, "aoi": [0.5], "vdf": [0.5]},
        "checks": [{"episodes": 6, "reward": 1.0, "aoi": 0.5, "vdf": 0.5}],
        "evaluation": flown(first, rewards),
        **dict.fromkeys(COUNTERS, 6),
    }


def run_here(self: Runner, jobs: Sequence[Job], seconds: Mapping[str, float], stop: StopSignal) -> bool:
    """Stand in for `Runner.run`: do the jobs inside this process."""
    assert {job.digest for job in jobs} == set(seconds), "every job has an estimate"
    for job in jobs:
        perform(job, self._records, self._command)
    return not stop
