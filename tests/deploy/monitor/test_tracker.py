"""Experiment trackers: what they get, and that they harm nobody."""

import sys
import threading
import time

import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import UsageError
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.cli import dispatch
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
        self.options, self.sent, self.ended = {}, [], False

    def begin(self, folder, options):
        self.options = dict(options)
        return f"here, as {folder.name}"

    def send(self, step, values):
        self.sent.append((step, values))

    def end(self):
        self.ended = True


def test_a_tracker_gets_configuration_and_scalars(tmp_path):
    """Each report of the learner once, by TensorBoard's names."""
    client = Client()
    tracked = Tracker(client, tmp_path / "mine", preset("default"), TEAM)
    for step in (10, 10, 20):
        tracked.log(metrics(step))
    tracked.log_scalars({"eval/mean_reward": 7.0})
    assert tracked.finish() == "client has the run: here, as mine"
    assert client.options["algorithm.name"] == "ippo"
    assert client.options["farm.world.sensor_cycles"] == "[40, 50, 60]"
    assert client.sent == [
        (10, {"charts/episodic_return": 10.0, "eia_sec/queue": 1.0}),
        (20, {"charts/episodic_return": 20.0, "eia_sec/queue": 1.0}),
        (20, {"eval/mean_reward": 7.0}),
    ]
    assert client.ended


def test_a_tracker_that_fails_is_counted_and_later_records_arrive(tmp_path):
    """A record that cannot be sent is lost alone."""

    class Failing(Client):
        def send(self, step, values):
            if step < 30:
                raise ConnectionError("the server is away\nmore")
            super().send(step, values)

    client = Failing()
    tracked = Tracker(client, tmp_path, preset("default"), TEAM)
    for step in (10, 20, 30):
        tracked.log(metrics(step))
    assert tracked.finish() == "2 records did not reach failing: the server is away"
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

    tracked = Tracker(Hanging(), tmp_path, preset("default"), TEAM)
    tracked.log(metrics(10))
    begun.wait()
    before = time.monotonic()
    for step in range(20, 100, 10):
        tracked.log(metrics(step))
    assert tracked.failure == "5 records did not reach hanging: it is too slow"
    assert tracked.finish() == "9 records did not reach hanging: it hangs"
    assert time.monotonic() - before < 5.0
    free.set()


def test_a_tracker_that_cannot_begin_is_a_mistake_of_the_user(tmp_path):
    """Before any process starts, in one sentence."""

    class Refusing(Client):
        def begin(self, folder, options):
            raise RuntimeError("nobody has logged in")

    with pytest.raises(UsageError, match="refusing cannot begin: nobody has logged in"):
        Tracker(Refusing(), tmp_path, preset("default"), TEAM)


@pytest.mark.parametrize("name", ["wandb", "mlflow"])
def test_a_missing_client_is_named_before_anything_is_made(tmp_path, monkeypatch, capsys, name):
    """The sentence names the extra; there is no run directory yet."""
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.chdir(tmp_path)
    assert run_command(lambda: dispatch(["train", "--preset", "quick", "--track", name])) == USAGE
    assert f"--track {name} needs its client: pip install 'eia-sec[{name}]'." in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("name", ["wandb", "mlflow"])
def test_a_run_directory_stays_usable_beside_a_tracker(tmp_path, monkeypatch, name):
    """The learner, and later a resume, prepare and lock it after the tracker has begun; both refuse links in it."""
    pytest.importorskip(name)
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.delenv("WANDB_DIR", raising=False)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.chdir(tmp_path)
    config, folder = preset("default"), tmp_path / "runs" / "mine"
    RunDirectory(folder).prepare(config, resume=False)
    tracked = Tracker(client_of(name), folder, config, TEAM)
    learner = RunDirectory(folder)
    learner.prepare(config, resume=False)
    learner.lock("learner.lock", directory=True)
    tracked.log(metrics(10))
    tracked.finish()
    learner.unlock()
    RunDirectory(folder).prepare(config, resume=True)


def test_wandb_keeps_a_run_offline(tmp_path, monkeypatch):
    """Everything is in one folder, to be uploaded by `wandb sync`."""
    pytest.importorskip("wandb").teardown()  # it reads its variables once
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_DIR", str(tmp_path))
    tracked = Tracker(client_of("wandb"), tmp_path / "mine", preset("default"), TEAM)
    tracked.log(metrics(10))
    said = tracked.finish()
    (record,) = (tmp_path / "wandb").glob("offline-run-*/run-*.wandb")
    assert said == f"wandb has the run: {record.parent}"
    deadline = time.monotonic() + 30.0  # a process of wandb's own writes it
    while b"charts/episodic_return" not in (content := record.read_bytes()) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert b"charts/episodic_return" in content
    assert b"algorithm.name" in content


def test_mlflow_keeps_a_run_in_files(tmp_path, monkeypatch):
    """Without a server's address they are in the run directory, and can be read again."""
    mlflow = pytest.importorskip("mlflow")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.setenv("MLFLOW_DISABLE_TELEMETRY", "true")
    tracked = Tracker(client_of("mlflow"), tmp_path, preset("default"), TEAM)
    for step in (10, 20):
        tracked.log(metrics(step))
    assert tracked.finish().startswith("mlflow has the run: file:")
    client = mlflow.MlflowClient((tmp_path / "mlflow").as_uri())
    experiment = client.get_experiment_by_name("eia-sec")
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.status == "FINISHED"
    assert run.data.params["algorithm.name"] == "ippo"
    history = client.get_metric_history(run.info.run_id, "charts/episodic_return")
    assert [(point.step, point.value) for point in history] == [(10, 10.0), (20, 20.0)]
