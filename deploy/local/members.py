"""The members of a population on this machine: their folders, configurations and processes."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.errors import ConfigError, EiaSecError, UsageError
from eia_sec.common.log import log
from eia_sec.common.seeds import derive
from eia_sec.common.team import TeamSpec
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.local.code_options import plugin_options
from eia_sec.deploy.local.run_directory import TRAIN_LOCK, RunDirectory
from eia_sec.deploy.local.supervisor import Supervisor
from eia_sec.deploy.local.training_processes import COORDINATOR, JOIN_SECONDS, ProcessPlan, TrainingProcesses
from eia_sec.deploy.monitor.run_monitor import RunMonitor
from eia_sec.elite.rounds import drawn

FOLDER: Final = "members"
"""Folder in the run directory with a run directory for each member."""
ELITE: Final = "elite"
"""The coordinator's process."""
SEEDS: Final = 2**31


def member_name(number: int) -> str:
    """Return the name of a member's run, and of its folder."""
    return f"member-{number}"


def member_config(config: RunConfig, number: int) -> RunConfig:
    """Return a member's configuration: its own seed and hyperparameters. Member 0 has those of the run."""
    shared = with_values(config, {"population.seed": config.seed})
    own = {f"algorithm.{name}": value for name, value in drawn(shared, number).items()}
    seed = config.seed if number == 0 else derive(config.seed, "member", number) % SEEDS
    return with_values(shared, {"seed": seed, **own})


def require_population(config: RunConfig) -> None:
    """Raise ConfigError for a configuration whose members could not train side by side."""
    if config.population.seed not in (0, config.seed):
        raise ConfigError("population.seed is the run's own seed; leave it out, and set seed.")
    if config.env.served:
        raise ConfigError(f"a population cannot share {config.env.name}, which others serve.")


def member_directories(root: Path, config: RunConfig) -> list[RunDirectory]:
    """Return the run directories of a population's members."""
    return [RunDirectory(root / FOLDER / member_name(number)) for number in range(config.population.members)]


class LocalMember:
    """A member whose processes run on this machine.

    Args:
        plan: its processes; the run's name is the member's.

    Attributes:
        plan: the same.
        processes: the same, once started.
        monitor: its state; None until its learner was reached.
        bus: the session with its learner, likewise.
        failure: why it was given up, or None.
    """

    def __init__(self, plan: ProcessPlan) -> None:
        self.plan, self.processes = plan, TrainingProcesses(plan)
        self.monitor: RunMonitor | None = None
        self.bus: Bus | None = None
        self.failure: EiaSecError | None = None

    @property
    def name(self) -> str:
        """Its run's name."""
        return self.plan.run

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return self.failure is not None or self.processes.over

    @contextmanager
    def given_up(self) -> Iterator[None]:
        """Give the member up, and go on with the others, where this block finds that its processes cannot go on."""
        try:
            yield
        except EiaSecError as error:
            self.failure = error
            log(f"{self.name} is given up: {error}")
            self.processes.stop()


class Members:
    """The processes of a population: those of its members that have not finished, and the coordinator.

    Args:
        root: the run directory.
        plan: what to start for each member; configuration, folder, endpoint and name are the member's own.
        team: the layout of the team.

    Raises:
        RunDirError: a member's folder cannot be used.

    Attributes:
        training: the members that have not finished.
        supervisor: starts and restarts the coordinator.
    """

    def __init__(self, root: RunDirectory, plan: ProcessPlan, team: TeamSpec) -> None:
        self._plan, self._held = plan, ExitStack()
        self.training: list[LocalMember] = []
        for number, directory in enumerate(member_directories(root.path, plan.config)):
            config = member_config(plan.config, number)
            directory.prepare(config, resume=plan.resume and directory.holds_run())
            directory.lock(TRAIN_LOCK)
            directory.adopt(config, team)
            own = replace(plan, config=config, directory=directory, run=member_name(number), coordinated=False)
            if not directory.finished():
                self.training.append(LocalMember(replace(own, endpoint=self._endpoint())))
        self.supervisor = Supervisor(root.path / "logs")

    def _endpoint(self) -> Endpoint:
        """Return where a member's learner listens, beside those of the members before it."""
        taken = [member.plan.endpoint.port for member in self.training]
        while (found := free_endpoint()).port in taken:
            pass
        asked = self._plan.endpoint
        return replace(found, protocol=asked.protocol, credentials=asked.credentials)

    def start(self) -> None:
        """Start all processes."""
        if not self.training:
            return
        for member in self.training:
            member.processes.start()
        where = [f"{member.name}={member.plan.endpoint}" for member in self.training]
        tls = [] if self._plan.tls is None else ["--tls", str(self._plan.tls / COORDINATOR)]
        patience = ["--patience", str(JOIN_SECONDS)]
        self.supervisor.start(ELITE, [ELITE, *plugin_options(self._plan.config), "--members", *where, *patience, *tls])

    def connect(self, stopped: Callable[[], bool]) -> None:
        """Reach the members' learners, and give up those that fail.

        Args:
            stopped: whether the user has stopped the run.
        """
        for member in self.training:
            with member.given_up():
                member.bus = member.processes.connect(stopped)
                if member.bus is not None:
                    self._held.enter_context(member.bus)
                    member.monitor = RunMonitor(member.bus, member.name)

    def watch(self) -> None:
        """Restart processes that died; give up members that cannot go on."""
        self.supervisor.watch()
        for member in self.training:
            if member.monitor is not None:
                member.monitor.update()
            if member.failure is None:
                with member.given_up():
                    member.processes.watch(training=member.monitor is not None and member.monitor.trains)
                    member.processes.raise_failure()

    @property
    def over(self) -> bool:
        """Whether all members have ended."""
        return all(member.over for member in self.training)

    def drain(self) -> list[str]:
        """Let all learners write a checkpoint and end; return what those say that refused."""
        asked = [(member, member.bus) for member in self.training if member.bus is not None and not member.over]
        refused = [f"{member.name}: {said}" for member, bus in asked if (said := member.processes.ask_to_drain(bus))]
        for member, _ in asked:
            member.processes.await_drained()
        return refused

    def stop(self) -> None:
        """End all processes, and close the sessions."""
        self.supervisor.stop()
        for member in self.training:
            member.processes.stop()
        self._held.close()

    def undelivered(self) -> list[str]:
        """Return what workers that have ended say of steps that are lost with them."""
        return [line for member in self.training for line in member.processes.undelivered()]

    def failure(self) -> EiaSecError | None:
        """Return who was given up and why; a UsageError where that are all members, for mistakes of the user."""
        failed = {member.name: member.failure for member in self.training if member.failure is not None}
        if not failed:
            return None
        whole = len(failed) == self._plan.config.population.members
        reasons = {str(error) for error in failed.values()}
        said = "; ".join(f"{name} failed: {error}" for name, error in failed.items())
        if whole and len(reasons) == 1:
            said = f"all members failed: {reasons.pop()}"
        mistakes = whole and all(isinstance(error, UsageError) for error in failed.values())
        return UsageError(said) if mistakes else EiaSecError(said)
