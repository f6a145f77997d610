"""Sends a run's metrics to an experiment tracker: Weights & Biases or MLflow.

A thread sends, through a bounded queue: a tracker that is slow, hangs or fails costs records, which are counted, and
never training.
"""

import importlib
import os
import queue
import re
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Literal, Protocol, Self

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import plain_options
from eia_sec.common.errors import CancelledError, UsageError
from eia_sec.common.protocol.metrics import scalars
from eia_sec.common.team import TeamSpec

TrackerName = Literal["wandb", "mlflow"]
Outcome = Literal["finished", "failed", "killed"]
"""How a run ended; `killed` is one that somebody stopped."""
PROJECT: Final = "eia-sec"
"""Project of Weights & Biases, or experiment of MLflow, unless their environment variables name another."""
WAITING: Final = 600
"""Records that wait to be sent, about one a second; further ones are lost."""
FAREWELL_SECONDS: Final = 30.0
"""Longest wait at the end for what has not been sent."""
MOST_PARAMETERS: Final = 100
"""Parameters in one request to MLflow, which refuses more."""
STEPS: Final = "environment_steps"
"""Name of Weights & Biases' horizontal axis."""
MOST_NAME: Final = 250
"""Most characters of a name that MLflow takes."""
MOST_TEXT: Final = 500
"""Most characters of a parameter of MLflow, which refuses longer ones, and of an error that is shown."""


class Client(Protocol):
    """A tracker's own library; every method may raise, or take long."""

    def begin(self, folder: Path, options: Mapping[str, bool | float | str]) -> str:
        """Begin a run with its configuration by dotted keys; return where it can be seen."""

    def send(self, step: int, values: Mapping[str, float]) -> None:
        """Send scalars by their names, at a number of environment steps."""

    def end(self, outcome: Outcome) -> None:
        """End the run."""


class _Wandb:
    """Weights & Biases, which keeps its files where WANDB_DIR says: they hold links, which a run directory must not."""

    def __init__(self, module: Any) -> None:
        self._module, self._run = module, module.Run

    def begin(self, folder: Path, options: Mapping[str, bool | float | str]) -> str:
        self._run = self._module.init(
            project=os.environ.get("WANDB_PROJECT", PROJECT),
            name=folder.name,
            group=folder.name,
            config=dict(options),
            settings=self._module.Settings(console="off", silent=True),
        )
        self._run.define_metric("*", step_metric=STEPS)
        return str(Path(self._run.dir).parent if self._run.offline else self._run.url)

    def send(self, step: int, values: Mapping[str, float]) -> None:
        # Not as `step`: wandb drops what is not beyond the newest one, and a resumed learner repeats steps.
        self._run.log({STEPS: step, **values})

    def end(self, outcome: Outcome) -> None:
        self._run.finish(exit_code=0 if outcome == "finished" else 1)


class _Mlflow:
    """MLflow; without MLFLOW_TRACKING_URI everything stays in the run directory."""

    def __init__(self, module: Any) -> None:
        self._module, self._client, self._run = module, module.MlflowClient, ""

    def begin(self, folder: Path, options: Mapping[str, bool | float | str]) -> str:
        where = os.environ.get("MLFLOW_TRACKING_URI", (folder / "mlflow").resolve().as_uri())
        os.environ.setdefault("MLFLOW_ALLOW_FILE_STORE", "true")  # MLflow 3 refuses folders without it
        self._client = client = self._module.MlflowClient(where)
        name = os.environ.get("MLFLOW_EXPERIMENT_NAME", PROJECT)
        known = client.get_experiment_by_name(name)
        experiment = client.create_experiment(name) if known is None else known.experiment_id
        self._run = client.create_run(experiment, run_name=folder.name).info.run_id
        entry = self._module.entities.Param
        parameters = [entry(_mlflow_name(key), str(value)[:MOST_TEXT]) for key, value in options.items()]
        for first in range(0, len(parameters), MOST_PARAMETERS):
            client.log_batch(self._run, params=parameters[first : first + MOST_PARAMETERS])
        return f"{where}, run {self._run}"

    def send(self, step: int, values: Mapping[str, float]) -> None:
        now = int(time.time() * 1000)
        entry = self._module.entities.Metric
        metrics = [entry(_mlflow_name(name), value, now, step) for name, value in values.items()]
        self._client.log_batch(self._run, metrics=metrics)

    def end(self, outcome: Outcome) -> None:
        self._client.set_terminated(self._run, status=outcome.upper())


def _mlflow_name(name: str) -> str:
    """Return a name that MLflow takes: one that it does not costs all of a request's metrics."""
    parts = re.sub(r"[^/\w.\- :]", "_", name)[:MOST_NAME].split("/")
    return "/".join("_" if part in ("", ".", "..") else part for part in parts)


_CLIENTS: Final[Mapping[str, Callable[[Any], Client]]] = {"wandb": _Wandb, "mlflow": _Mlflow}
_QUIET: Final = {"WANDB_ERROR_REPORTING": "false", "MLFLOW_DISABLE_TELEMETRY": "true"}
"""Variables that keep the libraries from reporting on their use to their makers, which nobody has asked for."""


def client_of(name: TrackerName) -> Client:
    """Return the client of a tracker; raise UsageError where its library is not installed."""
    for variable, value in _QUIET.items():
        os.environ.setdefault(variable, value)
    try:
        module = importlib.import_module(name)
    except ImportError:
        module = None
    # Any folder of this name, such as the one in which wandb keeps its files, can be imported, as an empty package.
    if module is None or getattr(module, "__file__", None) is None:
        raise UsageError(f"--track {name} needs its client: pip install 'eia-sec[{name}]'.")
    return _CLIENTS[name](module)


class Tracker:
    """A run of a tracker, which ends with the context, as `failed` where that raises.

    Args:
        client: the tracker's library.
        folder: the run directory, whose name the run gets.
        config: the run.
        team: its types of agents.
        tell: shows a sentence: before it connects, which may ask for a login or take long, and at the end.

    Attributes:
        where: where the run can be seen.
        failure: what has been lost and why, or empty.
        outcome: how the run ends unless an error ends it.

    Raises:
        UsageError: the tracker refuses to begin, for instance because nobody has logged in.
    """

    def __init__(
        self, client: Client, folder: Path, config: RunConfig, team: TeamSpec, tell: Callable[[str], None]
    ) -> None:
        self._client, self._types, self._tell = client, team.types, tell
        self._name = type(client).__name__.strip("_").lower()
        self.outcome: Outcome = "killed"
        tell(f"connecting to {self._name} ...")
        try:
            self.where = client.begin(folder, plain_options(config))
        except Exception as error:
            raise UsageError(f"{self._name} cannot begin: {_sentence(error)}") from error
        self.failure = ""
        self._lost, self._reason, self._newest, self._step = 0, "", -1.0, 0
        self._records: queue.Queue[tuple[int, Mapping[str, float]] | None] = queue.Queue(WAITING)
        # A daemon: a client that hangs must not keep the process from ending.
        self._thread = threading.Thread(target=self._send_all, name="tracker", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if isinstance(error, Exception) and not isinstance(error, CancelledError):
            self.outcome = "failed"
        self._tell(self._finish())

    def log(self, values: Mapping[str, Any]) -> None:
        """Send a learner's metrics, once."""
        if values.get("elapsed", self._newest) != self._newest:
            self._newest, self._step = values["elapsed"], int(values["environment_steps"])
            self.log_scalars(scalars(values, self._types))

    def log_scalars(self, values: Mapping[str, float]) -> None:
        """Send scalars by their names, at the step of the newest metrics."""
        try:
            self._records.put_nowait((self._step, values))
        except queue.Full:
            self._lose("it is too slow")

    def _finish(self) -> str:
        """End the tracker's run, and return a sentence on it."""
        deadline = time.monotonic() + FAREWELL_SECONDS
        try:
            self._records.put(None, timeout=FAREWELL_SECONDS)
        except queue.Full:
            self._reason = "it hangs"
        self._thread.join(max(0.0, deadline - time.monotonic()))
        if self._thread.is_alive():
            self._lost += self._records.qsize()
            self._lose(self._reason or "it hangs")
        return self.failure or f"{self._name} has the run: {self.where}"

    def _send_all(self) -> None:
        while (record := self._records.get()) is not None:
            try:
                self._client.send(*record)
            except Exception as error:
                self._lose(_sentence(error))
        try:
            self._client.end(self.outcome)
        except Exception as error:
            self._lose(_sentence(error))

    def _lose(self, reason: str) -> None:
        self._lost, self._reason = self._lost + 1, reason
        self.failure = f"{self._lost} records did not reach {self._name}: {reason}"


def _sentence(error: Exception) -> str:
    """Return the first line of an error's text, or its type."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:MOST_TEXT]
