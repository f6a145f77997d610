"""A whole run in one process: learner, workers, coordinators and a monitor on a simulated network, clock and disk.

All of them are the product's own; only the environment and the networks are toys (`toys.py`). The seed says which
faults come when. Nothing else is random, so that a seed that fails fails again at the same event:

    python -m tests.simulation 17            what happens with seed 17, event by event
    python -m tests.simulation 0:20000       every seed of a range; prints those that fail
"""

import random
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

from eia_sec.common import clock, incarnation
from eia_sec.common import log as log_module
from eia_sec.common.config.files import read_saved
from eia_sec.common.config.run import RunConfig
from eia_sec.common.history import history as history_module
from eia_sec.common.loops import Loop
from eia_sec.common.process import Presence, StopSignal, fetch_configuration
from eia_sec.common.team import TeamSpec
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.monitor.run_monitor import RunMonitor
from eia_sec.elite.service import Coordinator, CoordinatorOptions
from eia_sec.learner.checkpoint import compaction, files, writer
from eia_sec.learner.process import reporter, schedule
from eia_sec.learner.process import service as learner_service
from eia_sec.learner.process.options import LearnerOptions
from eia_sec.learner.process.service import Learner
from eia_sec.rollout.worker import evaluation_service, view_service
from eia_sec.rollout.worker import service as worker_service
from eia_sec.rollout.worker.outages import Outages
from eia_sec.rollout.worker.service import Worker, WorkerOptions
from tests.simulation.disk import CountedOs, CountedShutil, Disk, SimulatedPath
from tests.simulation.judge import RUN, Judge, ViolationError
from tests.simulation.network import Network, SimulatedBus, Weather
from tests.simulation.toys import ENVIRONMENT, ToyEnvironments, ToyTrainer, configuration, evaluate
from tests.simulation.world import DAY, Process, World

HEALED = 12.0
"""Faults come in the first so many simulated seconds."""
PATIENCE = 400.0
"""Simulated seconds after the last fault in which a run must end."""
FAREWELL = 40.0
"""Simulated seconds in which everybody ends once the run has."""
RECORDS = 12
"""Records of a history above which it is compacted, so that this happens in short runs, too."""
REPORT_SECONDS = 2.0
"""Time between two reports of a process, which cost more than all else."""
WORKERS = 3
BAD_MACHINES = 0.1
"""Share of the seeds in which machines crash often, and come back with another clock and a damaged checkpoint."""
SILENT_SECONDS = 10.0
"""Silence of a learner after which another one with a lower epoch may be followed."""
BAD_ENDS = 0.05
"""Share of the seeds whose learner is killed while it writes its last checkpoint."""
HARMLESS = (
    "bad network",
    "cut a machine off",
    "cut two machines off from each other",
    "a worker joins",
    "another coordinator",
    "freeze the learner",
    "freeze a worker",
    "freeze a coordinator",
    "kill a coordinator",
    "set a clock",
    "drain and resume",
)
"""Faults that cost no steps."""
ENDPOINT = Endpoint("tcp", "127.0.0.1", 1)

configuration = lru_cache(configuration)
read_saved = lru_cache(read_saved)


@dataclass(frozen=True)
class Outcome:
    """What became of a seed.

    Attributes:
        seed: the seed.
        failure: what does not hold, or empty.
        events: events until then.
        trace: what happened.
        faults: names of the faults that came.
        steps: steps by their fate, by the audit.
    """

    seed: int
    failure: str
    events: int
    trace: tuple[str, ...]
    faults: tuple[str, ...]
    steps: dict[str, int]


class Simulation:
    """One simulated run.

    Args:
        seed: determines everything.
        folder: a folder for its files.
    """

    def __init__(self, seed: int, folder: Path) -> None:
        self.world = world = World(seed)
        self.draw = world.draw
        self.network, self.judge, self.disk = Network(world), Judge(world), Disk(world)
        self.network.on_reply.append(self.judge.on_reply)
        self.network.on_put.append(self.judge.on_put)
        self.on_policy, self.lockstep = self.draw.random() < 0.4, self.draw.random() < 0.1
        self.config: RunConfig = configuration(on_policy=self.on_policy, seed=0)
        self.folder, self.homes = folder, 0
        self.histories = folder / "workers"
        self.histories.mkdir()
        self.home = SimulatedPath(folder / "run-0")
        Path(self.home).mkdir()
        self.processes: dict[str, Process] = {}
        self.learners: list[Process] = []
        self.starts = 0
        self.faults: list[str] = []
        self.finished = self.ending = self.stopped = False
        # Streams of their own, so that all other seeds stay what they were.
        self.bad_machines = random.Random(f"machines {seed}").random() < BAD_MACHINES
        end = random.Random(f"end {seed}")
        self.last_steps = end.randrange(1, 25) if end.random() < BAD_ENDS else None
        self.leavers: set[str] = set()
        world.on_death.append(self._died)

    # Processes.

    def process(self, node: str) -> Process:
        """Return a new start of what runs on a machine."""
        self.starts += 1
        before = self.processes.get(node)
        process = Process(f"{node}#{self.starts}", node, wall=before.wall if before else 0.0)
        self.processes[node] = process
        self.world.note(f"{process.name} starts")
        return process

    def bus(self, process: Process) -> Any:
        """Return a lane of a process."""
        return SimulatedBus(self.network, process)

    def start_learner(self, *, resume: bool, node: str = "learner") -> None:
        """Start a learner in the run's folder."""
        process = self.process(node)
        self.learners.append(process)
        stop = process.parts["stop"] = StopSignal()
        process.parts["home"] = self.home

        def loop() -> Loop[None]:
            control, bulk = self.bus(process), self.bus(process)
            expects = self.lockstep or self.draw.random() < 0.5
            options = LearnerOptions(
                RUN, ENDPOINT, False, self.home, resume=resume, lockstep=self.lockstep, await_elite=expects
            )
            learner = process.parts["learner"] = Learner(options, self.config, ENVIRONMENT, control, bulk)
            self._end_badly(process, learner)
            self.judge.check_resume(process)
            self.world.start(process, _forever(learner.receiver.receive))
            finished = yield from learner.run(stop)
            self.finished |= finished
            bulk.close()
            learner.receiver.close()

        self.world.start(process, loop())

    def _end_badly(self, process: Process, learner: Learner) -> None:
        """Kill a learner, in some seeds and once, while it writes the last checkpoint of its life."""
        write = learner._checkpoint

        def last(*, wait: bool = False) -> None:
            if not wait or self.last_steps is None:
                write(wait=wait)
                return
            process.fuse, self.last_steps = self.last_steps, None
            try:
                write(wait=True)
                process.fuse = None
            except BaseException:
                self.faults.append("kill the learner at its end")
                raise

        learner._checkpoint = last  # type: ignore[method-assign]  # of this learner alone

    def start_worker(self, node: str) -> None:
        """Start a worker."""
        process = self.process(node)
        stop = process.parts["stop"] = StopSignal()
        seconds = self.draw.uniform(0.1, 0.8)

        def loop() -> Loop[None]:
            control, bulk = self.bus(process), self.bus(process)
            answer = yield from fetch_configuration(control, RUN, node, lambda: not stop, 5.0)
            if answer is None:
                return
            start = incarnation.new_incarnation(answer.newest_incarnation)
            presence, outages = Presence(control, RUN, "rollout", node, start), Outages(stop.event)
            options = WorkerOptions(RUN, node, ENDPOINT, history=SimulatedPath(self.histories / f"{node}.jsonl"))
            environments: Any = ToyEnvironments(
                self.world, process, (node, start), seconds, self.judge.produced, on_policy=self.on_policy
            )
            config = read_saved(answer.toml)
            worker = process.parts["worker"] = Worker(
                options, config, answer, control, bulk, stop, presence, environments, start, outages
            )
            self.world.start(process, worker.sender.deliver())
            try:
                yield from worker.run()
            except Exception:
                worker.sender.close()
                worker.history.close()
                raise
            worker.sender.close()
            worker.history.close()

        self.world.start(process, loop())

    def start_coordinator(self, node: str) -> None:
        """Start a coordinator."""
        process = self.process(node)
        stop = process.parts["stop"] = StopSignal()

        def loop() -> Loop[None]:
            control = self.bus(process)
            answer = yield from fetch_configuration(control, RUN, node, lambda: not stop, 5.0)
            if answer is None:
                return
            options, team = CoordinatorOptions(RUN, ENDPOINT, node), TeamSpec.from_dict(answer.team)
            coordinator = process.parts["coordinator"] = Coordinator(options, read_saved(answer.toml), team, control)
            yield from coordinator.run(stop)

        self.world.start(process, loop())

    def start_monitor(self) -> None:
        """Start a monitor."""
        process = self.process("monitor")
        stop = process.parts["stop"] = StopSignal()

        def loop() -> Loop[None]:
            monitor = RunMonitor(self.bus(process), RUN)
            while not stop:
                yield 1.0
                monitor.update()
                self.judge.check_monitor(monitor)

        self.world.start(process, loop())

    def _died(self, process: Process) -> None:
        """Start again what did not end as intended, as a supervisor does."""
        error = process.parts.get("error")
        if isinstance(error, ViolationError):
            raise error
        if error is not None and not _lawful(process, error):
            raise ViolationError(f"{process.name} ends with {type(error).__name__}: {error}") from error
        if self.processes.get(process.node) is not process or self.stopped:
            return
        role = process.node.rstrip("0123456789")
        if (role == "learner" and (process.ended or not self.finished)) or process.ended:
            self.world.after(self.draw.uniform(0.5, 3.0), lambda: self._again(process))

    def _again(self, process: Process) -> None:
        if self.processes.get(process.node) is not process or self.stopped or (self.finished and not process.ended):
            return
        if self.bad_machines:
            self._set_clock(process)
        match process.node.rstrip("0123456789"):
            case "learner":
                damaged = self.draw.random() < (0.7 if self.bad_machines else 0.2) and self._damage()
                self.start_learner(resume=True, node=process.node)
                if damaged:
                    self._start_whom_it_needs()
            case "worker":
                self.start_worker(process.node)
            case "elite":
                self.start_coordinator(process.node)

    def _start_whom_it_needs(self) -> None:
        """Start workers that have ended: a finished run whose last checkpoint is lost goes on, as its user wants it."""
        for process in list(self.processes.values()):
            if process.node.startswith("worker") and not process.alive and process.node not in self.leavers:
                self.start_worker(process.node)

    def _damage(self) -> bool:
        """Flip a bit of the newest checkpoint and return True, if there is an older one."""
        found = sorted(Path(self.home).glob("checkpoints/checkpoint-*"))
        if len(found) >= 2:
            path = found[-1] / self.draw.choice(("tensors.safetensors", "manifest.json"))
            data = bytearray(path.read_bytes())
            data[self.draw.randrange(len(data))] ^= 1 << self.draw.randrange(8)
            path.write_bytes(bytes(data))
            self.world.note(f"{path.parent.name}/{path.name} is damaged")
            self.faults.append("damaged checkpoint")
        return len(found) >= 2

    # Faults.

    def _fault(self) -> None:
        """Let one drawn fault happen."""
        choices = self._choices()
        if self.bad_machines:
            choices = [choice for choice in choices if choice[0].startswith("kill")]
        name, fault = self.draw.choice(choices)
        self.faults.append(name)
        fault()

    def _choices(self) -> list[tuple[str, Callable[[], None]]]:
        found: list[tuple[str, Callable[[], None]]] = [
            ("kill the learner", lambda: self._kill(self.newest)),
            ("kill the learner in the middle of a write", lambda: self._burn(self.newest)),
            ("freeze the learner", lambda: self._freeze(self.newest)),
            ("cut a machine off", self._cut),
            ("cut two machines off from each other", self._separate),
            ("bad network", self._weather),
            ("another coordinator", self._join_coordinator),
            ("kill a coordinator", lambda: self._kill(self._any("elite"))),
            ("freeze a coordinator", lambda: self._freeze(self._any("elite"))),
            ("set a clock", lambda: self._set_clock(self._any(self.draw.choice(("worker", "learner", "elite"))))),
            ("drain and resume", lambda: self._stop(self.newest)),
        ]
        if not self.lockstep:
            found += [
                ("kill a worker", lambda: self._kill(self._any("worker"))),
                ("kill a worker in the middle of a write", lambda: self._burn(self._any("worker"))),
                ("freeze a worker", lambda: self._freeze(self._any("worker"))),
                ("a worker joins", self._join),
                ("a worker leaves", self._leave),
                ("replace a frozen worker", self._replace_worker),
                ("replace a frozen learner", self._replace_learner),
            ]
        return found

    @property
    def newest(self) -> Process:
        """The learner that was started last."""
        return self.learners[-1]

    def _any(self, role: str) -> Process:
        nodes = sorted(node for node in self.processes if node.startswith(role))
        return self.processes[self.draw.choice(nodes)]

    def _kill(self, process: Process) -> None:
        if process.alive:
            self.world.kill(process, "kill -9")
            if process.node.startswith("learner") and self.draw.random() < 0.5:
                self.faults.append("power cut")
                self.disk.power_cut(process)

    def _burn(self, process: Process) -> None:
        process.fuse = self.draw.randrange(1, 40)

    def _freeze(self, process: Process) -> None:
        seconds = self.draw.choice((0.5, 4.0, 12.0))
        process.frozen_until = self.world.now + seconds
        self.world.note(f"{process.name} stands still for {seconds} s")
        self._be_silent(seconds)

    def _cut(self) -> None:
        node, seconds = self.draw.choice(sorted(self.processes)), self.draw.choice((0.5, 2.0, 8.0, 15.0))
        self.network.partition(node, seconds)
        self._be_silent(seconds)

    def _be_silent(self, seconds: float) -> None:
        """Let everybody follow a learner with a lower epoch after this, if nothing is heard of one for that long."""
        if seconds > SILENT_SECONDS:
            for process in self.processes.values():
                process.parts["may_follow_lower"] = True

    def _separate(self) -> None:
        nodes = sorted({process.node for process in self._living()})
        if len(nodes) > 1:  # else everybody but the monitor is between two starts
            one, other = self.draw.sample(nodes, 2)
            self.network.separate(one, other, self.draw.choice((0.5, 2.0, 8.0, 15.0)))

    def _living(self) -> list[Process]:
        return [process for process in {*self.processes.values(), *self.learners} if process.alive]

    def _weather(self) -> None:
        draw = self.draw
        self.network.weather = Weather(
            draw.choice((0.0, 0.05, 0.2)),
            draw.choice((0.0, 0.2)),
            draw.choice((0.005, 0.1)),
            draw.choice((0.0, 0.05)),
            draw.choice((0.0, 0.1)),
        )
        self.faults.append("bad network")
        self.world.note(f"the network: {self.network.weather}")

    def _join_coordinator(self) -> None:
        self.start_coordinator(f"elite{1 + sum(node.startswith('elite') for node in self.processes)}")

    def _join(self) -> None:
        self.start_worker(f"worker{1 + sum(node.startswith('worker') for node in self.processes)}")

    def _leave(self) -> None:
        if len([p for p in self.processes.values() if p.node.startswith("worker") and p.alive]) > 1:
            process = self._any("worker")
            self.leavers.add(process.node)
            self._stop(process)

    def _stop(self, process: Process) -> None:
        self.world.note(f"{process.name} is asked to end")
        process.parts["stop"].event.set()

    def _set_clock(self, process: Process) -> None:
        process.wall += self.draw.choice((-DAY, -10.0, 10.0, DAY))
        self.world.note(f"the clock of {process.node} is {process.wall:.0f} s ahead")

    def _replace_worker(self) -> None:
        process = self._any("worker")
        if process.alive and "worker" in process.parts:
            process.frozen_until = self.world.now + 6.0
            process.parts["replaced"] = True
            self.world.note(f"{process.name} stands still and is replaced")
            self.start_worker(process.node)

    def _replace_learner(self) -> None:
        """Freeze the learner, and let another one take up a copy of its folder on another machine."""
        old = self.newest
        if not old.alive or "learner" not in old.parts:
            return
        self.homes += 1
        old.frozen_until = self.world.now + self.draw.uniform(3.0, 8.0)
        old.parts["replaced"] = True
        home = self.folder / f"run-{self.homes}"
        shutil.copytree(Path(self.home), home)
        self.home = SimulatedPath(home)
        del self.processes[old.node]
        self.world.note(f"{old.name} stands still, and a copy of its folder is taken up elsewhere")
        self.start_learner(resume=True, node=f"learner{self.homes}")

    # The run.

    def run(self) -> dict[str, int]:
        """Let it happen; return the steps by their fate, by the audit. Raises ViolationError."""
        world, draw = self.world, self.draw
        self.start_learner(resume=False)
        for index in range(1 if self.lockstep else draw.randint(1, WORKERS)):
            self.start_worker(f"worker{index + 1}")
        for index in range(draw.choice((1, 1, 2))):
            self.start_coordinator(f"elite{index + 1}")
        self.start_monitor()
        if draw.random() < 0.4:
            self._weather()
        for _ in range(draw.randint(0, 7)):
            world.after(draw.uniform(1.0, HEALED), self._fault)
        self._watch()
        world.run(world.now + HEALED, lambda: self.finished)
        self._heal()
        world.run(world.now + PATIENCE, lambda: self.finished)
        if not self.finished:
            raise ViolationError(f"the run has not ended {PATIENCE:.0f} s after the last fault; it stands still.")
        world.run(world.now + draw.uniform(0.0, 2.0), lambda: False)
        self.stopped = True
        for process in self.processes.values():
            process.parts["stop"].event.set()
        for process in self.learners:
            process.parts["stop"].event.set()
        everyone = [*self.processes.values(), *self.learners]
        world.run(world.now + FAREWELL, lambda: not any(process.alive for process in everyone))
        late = [process.name for process in everyone if process.alive]
        if late:
            raise ViolationError(f"{', '.join(late)} do not end {FAREWELL:.0f} s after they were asked to.")
        found = self.judge.check_end(self.newest, Path(self.home), self.histories)
        calm = all(fault in HARMLESS for fault in self.faults)
        lost = found.lost_with["learner"] + found.lost_with["unknown"]
        if calm and lost:
            raise ViolationError(f"{lost} steps are lost, though nobody was killed.")
        return {fate: found.steps[fate] for fate in ("accepted", "lost", "rejected", "in_flight")}

    def _heal(self) -> None:
        self.network.weather = Weather()
        self.world.note("no more faults")
        for process in self.processes.values():
            process.fuse = None
            if process.node in self.leavers and not process.alive:
                self.leavers.discard(process.node)
                self.start_worker(process.node)

    def _watch(self) -> None:
        """Check what must hold at any time, again and again."""
        for process in [*self.learners, *self.processes.values()]:
            if process.alive:
                self.judge.check_learner(process)
                self.judge.check_worker(process)
        self.world.after(0.5, self._watch)


def _forever(receive: Callable[[], Loop[None]]) -> Loop[None]:
    """Receive again and again: a simulated server's iteration ends when no request waits."""
    while True:
        yield from receive()
        yield 0.03


def _lawful(process: Process, error: Exception) -> bool:
    """Return whether a process may end with this error."""
    text = str(error)
    replaced = any(said in text for said in ("newer learner", "a newer start of it delivers", "another process writes"))
    return replaced and process.parts.get("replaced", False)


class _Executor:
    """Runs a job some time later, in the place of a thread."""

    def __init__(self, world: World) -> None:
        self._world = world

    def submit(self, job: Callable[..., None], *arguments: Any) -> "_Job":
        """Let the job be done later."""
        return _Job(self._world, job, arguments)


class _Job:
    def __init__(self, world: World, job: Callable[..., None], arguments: tuple[Any, ...]) -> None:
        assert world.current is not None
        self._world, self._process, self._job = world, world.current, lambda: job(*arguments)
        self._done = False
        world.after(world.draw.uniform(0.0, 2.0), self._do)

    def _do(self) -> None:
        if self._done or not self._process.alive:
            return
        if self._process.frozen_until > self._world.now:
            self._world.after(self._process.frozen_until - self._world.now, self._do)
            return
        with self._world.as_process(self._process):
            self.result()

    def result(self) -> None:
        """Do the job now, unless it is done."""
        if not self._done:
            self._done = True
            self._job()

    def done(self) -> bool:
        """Return whether the job is done."""
        return self._done


@contextmanager
def simulated(simulation: Simulation) -> Iterator[None]:
    """Let the product's clocks, files and random numbers be those of a simulation."""
    world, disk = simulation.world, simulation.disk
    SimulatedPath.disk = disk

    def trainer(config: RunConfig, team: TeamSpec, group: None = None) -> ToyTrainer:
        return ToyTrainer(config, team, world, simulation.judge.absorbed)

    def said(text: str) -> None:
        name = world.current.name if world.current is not None else ""
        world.note(f"{name}: {text.rstrip().partition(' ')[2]}")

    places: list[tuple[Any, str, Any]] = [
        (clock, "source", world),
        (incarnation, "secrets", SimpleNamespace(randbelow=world.draw.randrange)),
        (log_module, "sys", SimpleNamespace(stderr=SimpleNamespace(write=said, flush=lambda: None))),
        (history_module, "os", CountedOs(disk)),
        (files, "os", CountedOs(disk)),
        (files, "shutil", CountedShutil(disk)),
        (files, "time", SimpleNamespace(sleep=lambda seconds: None)),
        (writer, "ThreadPoolExecutor", lambda *arguments: _Executor(world)),
        (compaction, "MOST_RECORDS", RECORDS),
        (schedule, "PROGRESS_SECONDS", 0.3),
        (schedule, "REPORT_SECONDS", REPORT_SECONDS),
        (worker_service, "REPORT_SECONDS", REPORT_SECONDS),
        (reporter, "TensorBoardWriter", lambda *arguments: mock.MagicMock(failure="")),
        (view_service, "_probe", lambda *arguments: (SimpleNamespace(pictures=0, silence=""), b"")),
        (learner_service, "warm_up", lambda *arguments: None),
        (learner_service, "make_trainer", trainer),
        (worker_service, "read_saved", read_saved),
        (evaluation_service, "run_noise_free_episodes", evaluate),
    ]
    with ExitStack() as stack:
        for owner, name, value in places:
            stack.enter_context(mock.patch.object(owner, name, value))
        yield


def simulate(seed: int, scratch: str | None = None) -> Outcome:
    """Run one seed and return what became of it.

    Args:
        seed: the seed.
        scratch: where its files go meanwhile, preferably in memory.
    """
    with tempfile.TemporaryDirectory(dir=scratch, prefix="simulation-") as folder:
        simulation = Simulation(seed, Path(folder))
        failure, steps = "", {}
        with simulated(simulation):
            try:
                steps = simulation.run()
            except ViolationError as violation:
                failure = str(violation)
            except Exception as error:
                error.add_note(f"in the simulation of seed {seed}")
                raise
            world = simulation.world
            faults = tuple(dict.fromkeys(simulation.faults))
            return Outcome(seed, failure, world.events, tuple(world.trace), faults, steps)
