"""What a learner reports of a run that goes on after a crash."""

import json

import pytest
from tensorboardX.proto.event_pb2 import SessionLog
from tensorboardX.proto.plugin_hparams_pb2 import HParamsPluginData

from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import EpisodeSummary
from eia_sec.deploy.reports.run_report import read_metrics
from eia_sec.learner.process import metrics_log, tensorboard
from eia_sec.learner.process.curves import SMOOTHED_EPISODES, Curves
from eia_sec.learner.process.metrics_log import MetricsLog, _reopened
from eia_sec.learner.process.reporter import diverging
from eia_sec.learner.process.tensorboard import FOLDER, TensorBoardWriter
from tests.learner.off_policy.test_diagnostics import events

TEAM = TeamSpec((GroupSpec("a", 2, 3, 1), GroupSpec("b", 3, 2, 2)))


def write_run(log, first, last):
    """Write the records of some episodes, ten steps and one update each, and an imitation event after every second."""
    for episode in range(first, last):
        counters = {"episodes": episode, "environment_steps": 10 * episode, "updates": episode}
        log.write("episodes", **counters, reward={"mean": float(episode)})
        if episode % 2 == 0:
            log.write("imitation", episodes=episode, event=episode // 2)
        log.write("status", **counters)
    log.close()


def values_of(path, kind, name):
    return [record[name] for record in read_metrics(path) if record["kind"] == kind]


def test_what_a_crash_undid_is_left_out(tmp_path):
    """Of episodes 1..7 a checkpoint had kept 4, with an event fewer: the rest comes from the start that went on."""
    write_run(MetricsLog(tmp_path), 1, 8)
    log = MetricsLog(tmp_path)
    log.write("resume", episodes=4, environment_steps=40, updates=4, events=1)
    write_run(log, 5, 10)
    path = tmp_path / "metrics.jsonl"
    assert values_of(path, "episodes", "episodes") == values_of(path, "status", "updates") == list(range(1, 10))
    assert values_of(path, "imitation", "event") == [1, 3, 4]
    assert len(values_of(path, "resume", "time")) == 1


def test_a_run_that_begins_again_has_nothing_from_before(tmp_path):
    """Without a checkpoint everything is done again."""
    write_run(MetricsLog(tmp_path), 1, 4)
    log = MetricsLog(tmp_path)
    log.write("resume", episodes=0, environment_steps=0, updates=0, events=0)
    write_run(log, 1, 2)
    assert values_of(tmp_path / "metrics.jsonl", "episodes", "episodes") == [1]


@pytest.mark.parametrize("cut", [1, 5, 30])
def test_a_line_that_a_crash_has_cut_spoils_no_other(tmp_path, cut):
    """The next start ends it, so that its own first line can be read."""
    write_run(MetricsLog(tmp_path), 1, 3)
    path = tmp_path / "metrics.jsonl"
    path.write_bytes(path.read_bytes()[:-cut])
    write_run(MetricsLog(tmp_path), 3, 4)
    assert values_of(path, "episodes", "episodes") == [1, 2, 3]
    assert values_of(path, "status", "episodes") == [1, 3] if cut > 1 else [1, 2, 3]
    lines = path.read_text().splitlines()
    assert sum(line.endswith("}") for line in lines) >= len(lines) - 1
    assert json.loads(lines[-1])["kind"] == "status"


def test_moving_averages_go_on_with_the_episodes_before():
    """After a resumption they are those of the run that was not interrupted."""
    episodes = [EpisodeSummary(0, k, 50, (float(k),) * 5, {"aoi": 0.1 * k}) for k in range(60)]
    whole, resumed = Curves(TEAM), Curves(TEAM, episodes[:50])
    whole.add(episodes[:50])
    assert resumed.smoothed() == whole.smoothed() != Curves(TEAM).smoothed()
    assert resumed.smoothed()["reward"]["a"] == pytest.approx(
        sum(range(50 - SMOOTHED_EPISODES, 50)) / SMOOTHED_EPISODES
    )
    assert whole.add(episodes[50:]) == resumed.add(episodes[50:])
    assert resumed.smoothed() == whole.smoothed()


def test_tensorboard_learns_from_where_a_run_goes_on(tmp_path):
    """It leaves out what it has at the step of a session's start or beyond; the checkpoint's own step stays."""
    tensorboard = TensorBoardWriter(tmp_path)
    tensorboard.resume(700)
    tensorboard.close()
    starts = [event for event in events(tmp_path / FOLDER) if event.session_log.status == SessionLog.START]
    assert [event.step for event in starts] == [701]


def test_episodes_of_another_version_do_not_spoil_the_curves():
    """A checkpoint may hold episodes with other metrics; those that all have are averaged, and rewards stay ours."""
    rewards = (1.0,) * TEAM.agents
    before = [EpisodeSummary(0, 0, 50, rewards, {"aoi": 1.0, "reward": 9.0}), EpisodeSummary(0, 1, 50, rewards, {})]
    curves = Curves(TEAM, before)
    assert curves.smoothed() == {"reward": {"mean": 1.0, **{group.name: 1.0 for group in TEAM.groups}}, "steps": 50}


def test_records_go_on_after_a_full_disk_and_losses_are_counted(tmp_path, monkeypatch):
    """While nothing can be written each record is lost and counted; later ones are whole, and the count stands."""
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"kind": "cu')
    refused = [True, True, True, False]

    def opened(file):
        if refused.pop(0):
            raise OSError(28, "No space left on device")
        return _reopened(file)

    monkeypatch.setattr(metrics_log, "_reopened", opened)
    log = MetricsLog(tmp_path)
    assert log.failure == "metrics.jsonl cannot be written: No space left on device; 0 records are lost."
    log.write("status", episodes=1)
    log.write("status", episodes=2)
    assert log.failure.endswith("; 2 records are lost.")
    log.write("status", episodes=3)
    assert log.failure == "2 records of metrics.jsonl could not be written."
    log.close()
    log.write("status", episodes=4)
    lines = path.read_text().splitlines()
    assert [lines[0], json.loads(lines[1])["episodes"], len(lines)] == ['{"kind": "cu', 3, 2]


def test_a_metrics_log_on_a_full_disk_closes(tmp_path):
    """What its file still holds cannot be written at the end either, and ends nobody."""
    (tmp_path / "metrics.jsonl").symlink_to("/dev/full")
    log = MetricsLog(tmp_path)
    log.write("status", episodes=1)
    assert "No space left on device; 1 records are lost." in log.failure
    log.close()


def test_scalars_go_on_in_another_file_after_a_full_disk(tmp_path, monkeypatch):
    """After a pause a new event file is begun, and what was lost meanwhile is counted."""
    made = TensorBoardWriter(tmp_path)
    made.write(1, {"a": 1.0})
    monkeypatch.setattr(made._writer, "flush", refuse_to_write)
    made.write(2, {"a": 2.0})
    made.write(3, {"a": 3.0})
    assert made.failure == "TensorBoard's scalars cannot be written: No space left on device; 1 are lost."
    monkeypatch.setattr(tensorboard, "RETRY_SECONDS", 0.0)
    made._again = 0.0
    made.write(4, {"a": 4.0})
    made.close()
    assert made.failure == "2 TensorBoard events could not be written."
    files = sorted((tmp_path / FOLDER).iterdir())
    assert len(files) == 2
    steps = [event.step for event in events(tmp_path / FOLDER) if event.summary.value]
    assert (steps[0], steps[-1], 3 in steps) == (1, 4, False)


def refuse_to_write():
    raise OSError(28, "No space left on device")


def test_a_training_that_diverges_is_an_alarm():
    """The first statistic that is not finite is named, with the number of others."""
    assert diverging({"critic_loss": {"c": 1.0, "m": 2.0}}) == ""
    found = diverging({"critic_loss": {"c": float("nan"), "m": float("inf")}, "q_mean": {"c": 1.0}})
    assert found == "the training diverges: critic_loss/c and 1 more is not finite."


@pytest.mark.parametrize("how", ["removed", "renamed", "replaced"])
def test_metrics_that_are_removed_while_in_use_are_begun_anew(tmp_path, how):
    """The next record goes into a file that the path names, and an alarm says from then on what is missing."""
    path = tmp_path / "metrics.jsonl"
    log = MetricsLog(tmp_path)
    log.write("status", episodes=1)
    assert log.failure == ""
    if how == "renamed":
        path.rename(tmp_path / "elsewhere")
    else:
        path.unlink()
    if how == "replaced":
        path.write_text('{"kind": "status", "time": 0.0, "episodes": 7}\n')
    log.write("status", episodes=2)
    log.write("status", episodes=3)
    assert log.failure == "metrics.jsonl was removed while in use; its earlier records are gone."
    log.close()
    assert values_of(path, "status", "episodes") == ([7] if how == "replaced" else []) + [2, 3]


def test_an_event_file_that_is_removed_while_in_use_is_begun_anew(tmp_path):
    """TensorBoard's scalars go on in another file, and an alarm says so."""
    made = TensorBoardWriter(tmp_path)
    made.write(1, {"a": 1.0})
    (file,) = (tmp_path / FOLDER).iterdir()
    file.unlink()
    made.write(2, {"a": 2.0})
    made.close()
    assert made.failure == "TensorBoard's event file was removed while in use; its scalars are gone."
    assert [event.step for event in events(tmp_path / FOLDER) if event.summary.value] == [2]


def test_event_files_sort_by_start_and_not_by_the_clock(tmp_path, monkeypatch):
    """TensorBoard reads files by name; a later start comes later, even after the clock was set back."""
    folder = tmp_path / FOLDER
    folder.mkdir()
    (folder / "events.out.tfevents.1900000000.host.0").touch()
    names = []
    for clock in (1_800_000_000.0, 1_700_000_000.0, 1_600_000_000.0):
        monkeypatch.setattr("time.time", lambda clock=clock: clock)
        made = TensorBoardWriter(tmp_path)
        made.write(1, {"a": 1.0})
        made.close()
        names.append(made._file.name)
    assert sorted(path.name for path in folder.iterdir())[1:] == names
    assert all("tfevents" in name for name in names)


def test_tensorboard_shows_the_configuration(tmp_path):
    """As hyperparameters, beside the scalars that runs are compared by."""
    board = TensorBoardWriter(tmp_path)
    board.configuration({"seed": 3, "algorithm.name": "ippo", "flag": True}, ["charts/episodic_return"])
    board.close()
    found = {value.tag: value for event in events(tmp_path / FOLDER) for value in event.summary.value}
    assert set(found) >= {"_hparams_/experiment", "_hparams_/session_start_info"}
    begun = HParamsPluginData.FromString(found["_hparams_/session_start_info"].metadata.plugin_data.content)
    options = begun.session_start_info.hparams
    assert options["seed"].number_value == 3.0
    assert options["algorithm.name"].string_value == "ippo"
    whole = HParamsPluginData.FromString(found["_hparams_/experiment"].metadata.plugin_data.content)
    assert [metric.name.tag for metric in whole.experiment.metric_infos] == ["charts/episodic_return"]
