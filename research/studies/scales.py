"""How large the studies are: at full scale, and at a scale that only shows that everything works."""

from dataclasses import dataclass, replace
from typing import Final

from eia_sec.common.config import FarmConfig, RunConfig
from eia_sec.common.config.files import from_toml
from eia_sec.common.config.presets import PRESETS
from eia_sec.rollout.heuristics.registry import HEURISTICS

TRIAL_SEED: Final = 1000
"""Seed of every tuning trial; no run that is reported has it."""
FIRST_FARM: Final = 1000
"""First farm that trained policies and references are flown on; nothing is trained on it or any behind it."""
FIRST_REPORTED: Final = 1020
"""First farm that full results are made from. The preset was chosen by trials flown on farms 1000..1019
(docs/explanation/method.md), so these have had their say in what is compared. They stay in the records, whose jobs fly
them, and are left out of every statistic. For the methods of the studies nothing was chosen on the farms behind them;
settings of the presets `default` and `long` were (see research/studies/unseen.py)."""
CHOICE_FARM: Final = 500
"""First farm of the evaluations that choose settings and draw curves; neither trained on nor reported."""


@dataclass(frozen=True)
class Scale:
    """Sizes of all studies.

    Attributes:
        name: smoke or full.
        settings: TOML over the study preset, the same for every method, and over the preset `eia-sec`.
        on_policy: TOML over the preset `quick`, from which the studies on policy begin.
        episodes: budget of a run, episodes, those of elite imitation included.
        seeds: seeds of `training`, `default` and `on_policy`.
        side_seeds: seeds of `ablation` and `ensemble`.
        team_seeds: seeds of `scalability`.
        view_seeds: seeds of `observations`.
        trial_episodes: budget of a tuning trial.
        long_trial_episodes: the same of a method that converges later, see `Method.late`.
        candidates: settings that are tried for each method, the first of CANDIDATES.
        farms: farms that trained policies and references are flown on, from FIRST_FARM on.
        left_out: how many of them, from the first on, no result is made from.
        choice_farms: farms that settings are chosen on.
        points: points of a training curve.
        evaluations: noise-free evaluations on the way.
        members: values of k_s.
        uavs: team sizes that are trained.
        timed_uavs: team sizes whose decisions are timed.
        timed_steps: decisions that are timed, for each seed.
        timed_seeds: seeds of the timed actors.
        heuristics: the policies of which the best is 1 on the normalised scale; random is 0.
        flights: farms whose paths are drawn.
    """

    name: str
    settings: str
    on_policy: str
    episodes: int
    seeds: int
    side_seeds: int
    team_seeds: int
    view_seeds: int
    trial_episodes: int
    long_trial_episodes: int
    candidates: int
    farms: int
    left_out: int
    choice_farms: int
    points: int
    evaluations: int
    members: tuple[int, ...]
    uavs: tuple[int, ...]
    timed_uavs: tuple[int, ...]
    timed_steps: int
    timed_seeds: int
    heuristics: tuple[str, ...]
    flights: int

    def base(self) -> RunConfig:
        """Return the configuration that every method begins from; one thread for each run."""
        return self._settled(PRESETS["study"], self.settings)

    def preset(self) -> RunConfig:
        """Return the preset `eia-sec`, with the episodes that it says, or the budget where that is smaller."""
        config = self._settled(PRESETS["eia-sec"], self.settings)
        return replace(config, episodes=min(config.episodes, self.episodes))

    def quick(self) -> RunConfig:
        """Return the configuration from which the studies on policy begin: the preset instant's, in a short run."""
        return self._settled(PRESETS["quick"], self.on_policy)

    def _settled(self, config: RunConfig, settings: str) -> RunConfig:
        config = from_toml(settings, config)
        return replace(config, learner=replace(config.learner, threads=1), rollout=replace(config.rollout, threads=1))

    @property
    def reported(self) -> range:
        """Return the farms that results are made from."""
        return range(FIRST_FARM + self.left_out, FIRST_FARM + self.farms)

    @property
    def paper_farm(self) -> bool:
        """Whether the farm is that of the paper, so that rewards can stand beside the paper's."""
        return self.base().farm.world == FarmConfig().world


FULL: Final = Scale(
    name="full",
    settings="",
    on_policy="",
    episodes=800,
    seeds=5,
    side_seeds=5,
    team_seeds=3,
    view_seeds=2,
    trial_episodes=200,
    long_trial_episodes=400,
    candidates=5,
    farms=100,
    left_out=FIRST_REPORTED - FIRST_FARM,
    choice_farms=20,
    points=200,
    evaluations=20,
    members=(1, 2, 3, 4, 5, 10),
    uavs=(6, 12, 16, 20, 24, 48, 96),
    timed_uavs=(6, 12, 16, 20, 24, 48, 96),
    timed_steps=2000,
    timed_seeds=5,
    heuristics=tuple(name for name in HEURISTICS if name != "random"),
    flights=3,
)

SMOKE: Final = Scale(
    name="smoke",
    settings="""
    [farm.world]
    steps = 100
    [elite]
    cycle = 8
    farms = 2
    [replay]
    capacity = 4096
    warmup_steps = 800
    """,
    on_policy="""
    episodes = 32
    [farm.world]
    steps = 100
    [algorithm]
    iteration_steps = 800
    [rollout]
    environments = 8
    chunk_steps = 100
    """,
    episodes=40,
    seeds=2,
    side_seeds=2,
    team_seeds=2,
    view_seeds=2,
    trial_episodes=24,
    long_trial_episodes=32,
    candidates=2,
    farms=4,
    left_out=0,  # its numbers mean nothing, and the first farms show as well as others that everything works
    choice_farms=2,
    points=10,
    evaluations=4,
    members=(1, 2, 10),
    uavs=(6, 12, 24),
    timed_uavs=(6, 12, 24),
    timed_steps=100,
    timed_seeds=2,
    heuristics=("lawnmower", "greedy"),
    flights=1,
)

SCALES: Final = {scale.name: scale for scale in (SMOKE, FULL)}
"""Every scale by its name."""
