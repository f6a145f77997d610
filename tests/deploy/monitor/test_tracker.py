"""Experiment trackers: what they get, and that they harm nobody."""

import importlib
import os
import sys
import threading
import time
from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import CancelledError, UsageError
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.commands.training import train
from eia_sec.deploy.exit_codes import USAGE, run_command
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.monitor import tracker
from eia_sec.deploy.monitor.tracker import Tracker, client_of

TEAM = TeamSpec((GroupSpec("scout", 2, 3, 1),))


def metrics(step):
    return {"elapsed": step / 10, "environment_steps": step, "queue": 1, "curves": {"reward": {"mean": float(step)}}}


class Client:
    """Notes what it gets."""

    def __init__(self):
        self.options, self.sent, self.ended = {}, [], None

    def begin(self, folder, options):
        self.options = dict(options)
        return f"here, as {folder.name}"

    def send(self, step, values):
        self.sent.append((step, values))

    def end(self, outcome):
        self.ended = outcome


def test_a_tracker_gets_configuration_and_scalars(tmp_path):
    """Each report of the learner once, by TensorBoard's names."""
    client, said = Client(), []
    with Tracker(client, tmp_path / "mine", preset("instant"), TEAM, said.append) as tracked:
        for step in (10, 10, 20):
            tracked.log(metrics(step))
        tracked.log_scalars({"eval/mean_reward": 7.0})
        tracked.outcome = "finished"
    assert said == ["connecting to client ...", "client has the run: here, as mine"]
    assert client.options["algorithm.name"] == "ippo"
    assert client.options["farm.world.sensor_cycles"] == "[40, 50, 60]"
    assert client.sent == [
        (10, {"charts/episodic_return": 10.0, "eia_sec/queue": 1.0}),
        (20, {"charts/episodic_return": 20.0, "eia_sec/queue": 1.0}),
        (20, {"eval/mean_reward": 7.0}),
    ]
    assert client.ended == "finished"


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (None, "killed"),
        (KeyboardInterrupt(), "killed"),
        (CancelledError(), "killed"),
        (UsageError("a learner failed"), "failed"),
    ],
)
def test_a_run_that_does_not_finish_ends_as_that(tmp_path, error, outcome):
    """Stopped by somebody, or by an error; what it had sent has arrived, and where it is has been said."""
    client, said = Client(), []
    with (
        pytest.raises(type(error)) if error else nullcontext(),
        Tracker(client, tmp_path / "mine", preset("instant"), TEAM, said.append) as tracked,
    ):
        tracked.log(metrics(10))
        if error:
            raise error
    assert client.ended == outcome
    assert [step for step, _ in client.sent] == [10]
    assert said[-1] == "client has the run: here, as mine"


class _BegunError(Exception):
    """Training would begin."""


@pytest.mark.parametrize(("finished", "failing", "outcome"), [(1, 0, "finished"), (0, 0, "killed"), (0, 1, "failed")])
def test_train_says_how_a_run_ended(tmp_path, monkeypatch, finished, failing, outcome):
    """Whether the learner finished, was stopped, or a process failed."""
    client, folder = Client(), tmp_path / "mine"

    def run(training):
        if failing:
            raise _BegunError

    monkeypatch.setattr(train, "client_of", lambda name: client)
    monkeypatch.setattr(train._Training, "run", run)
    monkeypatch.setattr(RunDirectory, "finished", lambda directory: bool(finished))
    line = ["train", "--preset", "quick", "--track", "wandb", "--run-dir", str(folder), "--no-report"]
    with pytest.raises(_BegunError) if failing else nullcontext():
        dispatch(line)
    assert client.ended == outcome


def test_a_tracker_that_fails_is_counted_and_later_records_arrive(tmp_path):
    """A record that cannot be sent is lost alone."""

    class Failing(Client):
        def send(self, step, values):
            if step < 30:
                raise ConnectionError("the server is away\nmore")
            super().send(step, values)

    client, said = Failing(), []
    with Tracker(client, tmp_path, preset("instant"), TEAM, said.append) as tracked:
        for step in (10, 20, 30):
            tracked.log(metrics(step))
    assert said[-1] == "2 records did not reach failing: the server is away"
    assert [step for step, _ in client.sent] == [30]


def test_a_tracker_that_hangs_delays_nobody(tmp_path, monkeypatch):
    """What does not fit in the queue is lost and counted, and the end is not waited for longer than agreed."""
    monkeypatch.setattr(tracker, "WAITING", 3)
    monkeypatch.setattr(tracker, "FAREWELL_SECONDS", 0.2)
    free, begun = threading.Event(), threading.Event()

    class Hanging(Client):
        def send(self, step, values):
            begun.set()
            free.wait()

    said = []
    with Tracker(Hanging(), tmp_path, preset("instant"), TEAM, said.append) as tracked:
        tracked.log(metrics(10))
        begun.wait()
        before = time.monotonic()
        for step in range(20, 100, 10):
            tracked.log(metrics(step))
        assert tracked.failure == "5 records did not reach hanging: it is too slow"
    assert said[-1] == "9 records did not reach hanging: it hangs"
    assert time.monotonic() - before < 5.0
    free.set()


def test_a_tracker_that_cannot_begin_is_a_mistake_of_the_user(tmp_path):
    """Before any process starts, in one sentence; that it connects, which may take long, has been said."""
    said = []

    class Refusing(Client):
        def begin(self, folder, options):
            assert said == ["connecting to refusing ..."]
            raise RuntimeError("nobody has logged in")

    with pytest.raises(UsageError, match="refusing cannot begin: nobody has logged in"):
        Tracker(Refusing(), tmp_path, preset("instant"), TEAM, said.append)


@pytest.mark.parametrize("name", ["wandb", "mlflow"])
def test_a_missing_client_is_named_before_anything_is_made(tmp_path, monkeypatch, capsys, name):
    """The sentence names the extra; there is no run directory yet."""
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.chdir(tmp_path)
    assert run_command(lambda: dispatch(["train", "--preset", "quick", "--track", name])) == USAGE
    assert f"--track {name} needs its client: pip install 'eia-sec[{name}]'." in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_folder_of_a_clients_name_is_no_client(tmp_path, monkeypatch):
    """Such as the one in which wandb keeps its files: Python imports it as an empty package."""
    (tmp_path / "wandb").mkdir()
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    monkeypatch.delitem(sys.modules, "wandb", raising=False)
    with pytest.raises(UsageError, match="--track wandb needs its client"):
        client_of("wandb")
    sys.modules.pop("wandb")


@pytest.mark.parametrize(
    ("name", "variable", "given"),
    [("wandb", "WANDB_ERROR_REPORTING", "false"), ("mlflow", "MLFLOW_DISABLE_TELEMETRY", "true")],
)
def test_clients_report_to_nobody_unasked(monkeypatch, name, variable, given):
    """Before their import; a user's own value stays."""

    def found(name):
        return SimpleNamespace(__file__=os.environ[variable], Run=None, MlflowClient=None)

    monkeypatch.setattr(importlib, "import_module", found)
    for own in (None, "mine"):
        monkeypatch.setenv(variable, "mine")
        if own is None:
            monkeypatch.delenv(variable)
        assert client_of(name)._module.__file__ == (own or given)


def test_wandb_takes_what_a_resumed_learner_repeats(tmp_path):
    """Steps are values, and the axis of all others: of steps that fall, wandb would drop the records."""
    called, run = [], SimpleNamespace(offline=False, url="there")
    run.define_metric = lambda name, step_metric: called.append((name, step_metric))
    run.log = called.append
    module = SimpleNamespace(Run=None, Settings=dict, init=lambda **given: run)
    client = tracker._Wandb(module)
    assert client.begin(tmp_path, {}) == "there"
    for step in (20, 10):
        client.send(step, {"losses/a": 1.0})
    assert called == [
        ("*", "environment_steps"),
        {"environment_steps": 20, "losses/a": 1.0},
        {"environment_steps": 10, "losses/a": 1.0},
    ]


@pytest.mark.parametrize("name", ["wandb", "mlflow"])
def test_a_run_directory_stays_usable_beside_a_tracker(tmp_path, monkeypatch, name):
    """The learner, and later a resume, prepare and lock it after the tracker has begun; both refuse links in it."""
    pytest.importorskip(name)
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.delenv("WANDB_DIR", raising=False)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.chdir(tmp_path)
    config, folder = preset("instant"), tmp_path / "runs" / "mine"
    RunDirectory(folder).prepare(config, resume=False)
    with Tracker(client_of(name), folder, config, TEAM, print) as tracked:
        learner = RunDirectory(folder)
        learner.prepare(config, resume=False)
        learner.lock("learner.lock", directory=True)
        tracked.log(metrics(10))
    learner.unlock()
    resumed = RunDirectory(folder)
    resumed.prepare(config, resume=True)
    assert resumed.configuration() == config


def test_wandb_keeps_a_run_offline(tmp_path, monkeypatch):
    """Everything is in one folder, to be uploaded by `wandb sync`."""
    pytest.importorskip("wandb").teardown()  # it reads its variables once
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_DIR", str(tmp_path))
    said = []
    with Tracker(client_of("wandb"), tmp_path / "mine", preset("instant"), TEAM, said.append) as tracked:
        tracked.log(metrics(10))
    (record,) = (tmp_path / "wandb").glob("offline-run-*/run-*.wandb")
    assert said[-1] == f"wandb has the run: {record.parent}"
    deadline = time.monotonic() + 30.0  # a process of wandb's own writes it
    while b"charts/episodic_return" not in (content := record.read_bytes()) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert b"charts/episodic_return" in content
    assert b"algorithm.name" in content


ODD = {
    "charts/gain (dB)": "charts/gain _dB_",
    "charts/100%": "charts/100_",
    "charts//a/../b": "charts/_/a/_/b",
    "/c": "_/c",
    "d" * 300: "d" * 250,
}
"""Names of an environment's metrics, of which MLflow takes none, and what it gets."""


def test_mlflow_gets_names_that_it_takes():
    """Names that it takes stay; in others what it refuses becomes an underscore."""
    assert {name: tracker._mlflow_name(name) for name in ODD} == ODD
    assert tracker._mlflow_name("losses/a b.c-d:e_f") == "losses/a b.c-d:e_f"


@pytest.mark.parametrize("outcome", ["finished", "failed", "killed"])
def test_mlflow_keeps_a_run_in_files(tmp_path, monkeypatch, outcome):
    """Without a server's address they are in the run directory, and can be read again."""
    mlflow = pytest.importorskip("mlflow")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    said = []
    with Tracker(client_of("mlflow"), tmp_path, preset("instant"), TEAM, said.append) as tracked:
        for step in (10, 20):
            tracked.log(metrics(step))
        tracked.log_scalars({name: 1.0 for name in ODD})
        tracked.outcome = outcome
    assert said[-1].startswith("mlflow has the run: file:")
    client = mlflow.MlflowClient((tmp_path / "mlflow").as_uri())
    experiment = client.get_experiment_by_name("eia-sec")
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.status == outcome.upper()
    assert run.data.params["algorithm.name"] == "ippo"
    assert set(ODD.values()) < set(run.data.metrics)
    history = client.get_metric_history(run.info.run_id, "charts/episodic_return")
    assert [(point.step, point.value) for point in history] == [(10, 10.0), (20, 20.0)]
