"""Training of a population on this machine: learners, one coordinator, a view of all, and the best at the end."""

import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

from rich.console import Console
from rich.live import Live
from rich.table import Table

from eia_sec.common.config import RunConfig
from eia_sec.common.policy_file import POLICY, load_policy
from eia_sec.common.population import hyperparameters_of, round_due
from eia_sec.common.process import StopSignal
from eia_sec.common.reward_sums import RewardSums
from eia_sec.common.team import TeamSpec
from eia_sec.deploy.local.contained_files import write
from eia_sec.deploy.local.members import LocalMember, Members, member_directories
from eia_sec.deploy.local.run_directory import METRICS, RunDirectory
from eia_sec.deploy.monitor.new_alarms import NewAlarms
from eia_sec.deploy.monitor.population_view import render_population, summaries
from eia_sec.deploy.monitor.snapshot import Snapshot
from eia_sec.elite.evaluation_plan import population_plan
from eia_sec.elite.rounds import Ranking, ranked
from eia_sec.rollout.worker.collector import run_noise_free_episodes

REFRESH_SECONDS: Final = 0.5
PLAIN_SECONDS: Final = 10.0
"""Seconds between two lines of output for each member without a terminal."""
LINEAGE: Final = "lineage.png"
FILE_MODE: Final = 0o644


class PopulationTraining:
    """The processes of a population, and the view of them.

    Args:
        members: the processes.
        console: shows them.
    """

    def __init__(self, members: Members, console: Console) -> None:
        self._members, self._console = members, console
        self._stop = StopSignal()
        self._alarms: dict[str, NewAlarms] = {}
        self._printed = 0.0

    def run(self) -> None:
        """Train until all members are done or given up, or the user stops; no process is left afterwards."""
        self._stop.install()
        members = self._members
        try:
            members.start()
            members.connect(lambda: bool(self._stop))
            self._watch()
            if self._stop:
                self._tell("draining; the learners are writing checkpoints ...")
                for refused in members.drain():
                    self._tell(f"refused to drain: {refused}")
        finally:
            members.stop()
            self._stop.uninstall()
        if self._stop:
            for line in members.undelivered():
                self._tell(line)

    def _watch(self) -> None:
        if not self._console.is_terminal:
            while not (self._stop or self._members.over):
                self._tick()
                self._say()
            return
        with Live(console=self._console, auto_refresh=False, transient=False) as live:
            while not (self._stop or self._members.over):
                self._tick()
                live.update(render_population(self._snapshots(), self._members.supervisor.alarms), refresh=True)

    def _tick(self) -> None:
        self._members.watch()
        self._stop.event.wait(REFRESH_SECONDS)

    def _snapshots(self) -> dict[str, Snapshot | None]:
        return {member.name: _snapshot(member) for member in self._members.training}

    def _say(self) -> None:
        """Print new alarms, and from time to time a line for each member."""
        snapshots = self._snapshots()
        for name, snapshot in snapshots.items():
            if snapshot is not None:
                for line in self._alarms.setdefault(name, NewAlarms()).of(snapshot):
                    self._tell(f"{name}: {line}")
        if time.monotonic() - self._printed >= PLAIN_SECONDS:
            self._printed = time.monotonic()
            for line in summaries(snapshots):
                self._tell(line)

    def _tell(self, line: str) -> None:
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)


def _snapshot(member: LocalMember) -> Snapshot | None:
    if member.monitor is None:
        return None
    failure = () if member.failure is None else (str(member.failure),)
    return member.monitor.snapshot((*member.processes.supervisor.alarms, *failure))


def best_member(root: RunDirectory, config: RunConfig, team: TeamSpec, console: Console) -> RunDirectory:
    """Score the final policies of the members, print them with their lineage, and return the best one's folder.

    They fly noise-free episodes on training farms, as in a round: the best one is not chosen by the farms on which a
    report evaluates it. Its policy becomes that of the run directory.

    Args:
        root: the run directory of a population of which one member or more has finished; the others are left out.
        config: its configuration.
        team: the layout of the team.
        console: prints the table.
    """
    from eia_sec.deploy.reports.lineage import exploits, lineage, sentences  # noqa: PLC0415  (loading the plots would delay the processes)
    from eia_sec.deploy.reports.run_report import read_metrics  # noqa: PLC0415  (likewise)

    finished = [directory for directory in member_directories(root.path, config) if directory.finished()]
    directories = {directory.path.name: directory for directory in finished}
    console.print("scoring the members on training farms ...", highlight=False)
    ranking = _final_ranking(directories, team)
    metrics = {name: exploits(read_metrics(directory.path / METRICS)) for name, directory in directories.items()}
    console.print(_table(ranking, metrics, config), highlight=False)
    for line in sentences(metrics):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    write(root.path, POLICY, (directories[ranking.best].path / POLICY).read_bytes(), FILE_MODE)
    written = POLICY
    if any(metrics.values()):
        lineage(metrics, root.path / LINEAGE, f"{root.path.name}: {config.algorithm.name}, seed {config.seed}")
        written = f"{POLICY}, {LINEAGE}"
    console.print(f"the best is {ranking.best}; written to {root.path}: {written}", highlight=False, soft_wrap=True)
    return directories[ranking.best]


def _final_ranking(directories: dict[str, RunDirectory], team: TeamSpec) -> Ranking:
    rewards = {}
    for name, directory in directories.items():
        config = directory.configuration()
        plan = population_plan(config, round_due(config, 1.0) + 1)
        reward, steps = run_noise_free_episodes(config, load_policy(directory.path / POLICY)[0], *plan)
        rewards[name] = RewardSums.of(reward, int(steps.sum()))
    return ranked(team, config.elite, rewards)


def _table(ranking: Ranking, metrics: Mapping[str, Sequence[Mapping[str, Any]]], config: RunConfig) -> Table:
    """Return the members by their final scores, the best first, with the rounds that they took part in."""
    table = Table(box=None, pad_edge=False)
    table.add_column("member")
    for name in ("score omega", "rounds"):
        table.add_column(name, justify="right")
    names = list(hyperparameters_of(config))
    for name in names:
        table.add_column(name, justify="right")
    for member in sorted(ranking.scores, key=lambda one: -ranking.scores[one]):
        values = metrics[member][-1]["hyperparameters"] if metrics[member] else {}
        shown = [f"{values[name]:.3g}" if name in values else "-" for name in names]
        rounds = f"{len(metrics[member])} of {round_due(config, 1.0)}"
        table.add_row(member, f"{ranking.scores[member]:.4g}", rounds, *shown)
    return table
