"""The jobs of all studies at one scale, and their results."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eia_sec.common.config import RunConfig
from eia_sec.common.config.presets import preset
from eia_sec.deploy.reports.intervals import Numbers, interquartile_mean
from research.studies.jobs import Job, Records
from research.studies.methods import CANDIDATES, TUNED_PRESET, Method, configuration, with_uavs
from research.studies.scales import CHOICE_FARM, FIRST_FARM, TRIAL_SEED, Scale

PRESET_CANDIDATE = next(iter(CANDIDATES))
TWELVE = 12
"""UAVs of every study but those that vary them."""


class Bench:
    """Jobs at one scale.

    Args:
        scale: the sizes.
        records: what has been done.
    """

    def __init__(self, scale: Scale, records: Records) -> None:
        self.scale, self.records = scale, records

    def base(self, uavs: int = TWELVE) -> RunConfig:
        """Return what every method begins from, with a team of so many UAVs."""
        return with_uavs(self.scale.base(), uavs)

    def trials(self, method: Method) -> list[Job]:
        """Return the tuning trials of a method: each candidate once, evaluated on the farms of choice alone."""
        scale = self.scale
        episodes = scale.long_trial_episodes if method.late else scale.trial_episodes
        return [
            self._train(
                f"{method.name}, trial: {candidate}",
                configuration(self.base(), method, candidate, TRIAL_SEED, episodes),
                (CHOICE_FARM, scale.choice_farms),
            )
            for candidate in list(CANDIDATES)[: scale.candidates]
        ]

    def choice(self, method: Method) -> str:
        """Return the candidate of a method with the best reward; the first one as long as trials are missing."""
        trials = self.trials(method)
        if self.records.missing(trials):
            return PRESET_CANDIDATE
        return list(CANDIDATES)[int(np.argmax(self.trial_rewards(method)))]

    def trial_rewards(self, method: Method) -> list[float]:
        """Return the mean reward per agent of each of a method's trials, on the farms of choice."""
        return [float(np.mean(self.records.result(trial)["evaluation"]["reward"])) for trial in self.trials(method)]

    def runs(self, method: Method, seeds: int, *, tuned_as: Method | None = None, uavs: int = TWELVE) -> list[Job]:
        """Return the reported runs of a method.

        Args:
            method: the method.
            seeds: how many, from 0 on.
            tuned_as: the method whose choice of settings is in force; itself when None.
            uavs: size of the team.
        """
        candidate = self.choice(tuned_as or method)
        size = "" if uavs == TWELVE else f", {uavs} UAVs"
        return [
            self._train(
                f"{method.name}{size}, seed {seed}",
                configuration(self.base(uavs), method, candidate, seed, self.scale.episodes),
                (FIRST_FARM, self.scale.farms),
            )
            for seed in range(seeds)
        ]

    def preset_runs(self, seeds: int) -> list[Job]:
        """Return runs of the preset `eia-sec` for so many seeds from 0 on: `train --preset eia-sec --seed N`."""
        preset = self.scale.preset()
        return [
            self._train(f"{TUNED_PRESET}, seed {seed}", replace(preset, seed=seed), (FIRST_FARM, self.scale.farms))
            for seed in range(seeds)
        ]

    def on_policy_runs(self, method: Method, seeds: int) -> list[Job]:
        """Return runs of a method on policy, whose settings nothing has tuned, for so many seeds from 0 on."""
        base = self.scale.quick()
        return [
            self._train(
                f"{method.name}, seed {seed}",
                configuration(base, method, PRESET_CANDIDATE, seed, base.episodes),
                (FIRST_FARM, self.scale.farms),
            )
            for seed in range(seeds)
        ]

    def reference(self, policy: str, uavs: int = TWELVE) -> Job:
        """Return the flight of a policy that learns nothing over the reported farms."""
        size = "" if uavs == TWELVE else f", {uavs} UAVs"
        options = {"policy": policy, "farms": [FIRST_FARM, self.scale.farms]}
        # Nothing of the learning enters: without it, trials of settings leave these records as they are.
        config = replace(preset("study"), farm=self.base(uavs).farm)
        return Job("fly", f"{policy}{size}", config, options)

    def references(self, uavs: int = TWELVE) -> list[Job]:
        """Return the flights of the random policy and of every heuristic."""
        return [self.reference(name, uavs) for name in ("random", *self.scale.heuristics)]

    def timing(self, method: Method, uavs: int) -> list[Job]:
        """Return the timings of a method's decisions, for several seeds."""
        return [
            Job(
                "time",
                f"time of {method.name}, {uavs} UAVs, seed {seed}",
                configuration(self.base(uavs), method, PRESET_CANDIDATE, seed, 1),
                {"steps": self.scale.timed_steps},
            )
            for seed in range(self.scale.timed_seeds)
        ]

    def evaluations(self, runs: Sequence[Job]) -> list[dict[str, Any]]:
        """Return the evaluations of runs or references that are done, on the reported farms alone."""
        results = [self.records.result(run) for run in runs]
        return [self._reported(result.get("evaluation", result)) for result in results]

    def scores(self, runs: Sequence[Job]) -> Numbers:
        """Return [runs, farms] reward per agent of runs or references that are done, on the reported farms alone."""
        return np.array([evaluation["reward"] for evaluation in self.evaluations(runs)], np.float64)

    def ends(self, uavs: int = TWELVE) -> tuple[Numbers, Numbers, str]:
        """Return the rewards [farms] of the random policy and of the best heuristic, and that one's name."""
        jobs = self.references(uavs)
        rewards = {str(job.options["policy"]): scores for job, scores in zip(jobs, self.scores(jobs), strict=True)}
        best = max(self.scale.heuristics, key=lambda name: float(interquartile_mean(rewards[name][None])))
        return rewards["random"], rewards[best], best

    def _reported(self, evaluation: Mapping[str, Any]) -> dict[str, Any]:
        """Return a record's lists over farms without those farms that no result is made from.

        The one place where they are left out: what a job flies, and with it its digest, stays what it was.
        """
        first, farms = int(evaluation["first_farm"]), self.scale.reported
        part = slice(farms.start - first, farms.stop - first)
        assert len(evaluation["reward"][part]) == len(farms), "asked of other farms than those of the scale"
        sections = ("types", "metrics")
        return {"reward": evaluation["reward"][part]} | {
            section: {name: values[part] for name, values in evaluation[section].items()} for section in sections
        }

    def _train(self, label: str, config: RunConfig, farms: tuple[int, int]) -> Job:
        scale = self.scale
        options: dict[str, Any] = {
            "farms": list(farms),
            "choice_farms": [CHOICE_FARM, scale.choice_farms],
            "points": scale.points,
            "evaluations": scale.evaluations,
        }
        return Job("train", label, config, options)
