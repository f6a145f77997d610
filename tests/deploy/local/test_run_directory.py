"""A run directory belongs to one learner at a time, whatever happens to the files in it."""

import multiprocessing
import re
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import to_toml
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import RunDirError, UsageError
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.local.run_directory import LAST_LINE_BYTES, RunDirectory, new_folder


def hold(path: Path, line: Connection) -> None:
    """Lock a run directory as a learner does, in a separate process, until stopped."""
    directory = RunDirectory(path)
    try:
        directory.lock("learner.lock", directory=True)
    except RunDirError as error:
        line.send(str(error))
    else:
        line.send("held")
    line.recv()


@pytest.mark.parametrize("deed", ["nothing", "removed", "renamed"])
def test_a_second_learner_is_refused_although_the_lock_file_is_gone(tmp_path: Path, deed: str) -> None:
    """The folder itself is locked; once the first learner has ended, the next one gets it."""
    path = tmp_path / "run"
    path.mkdir()
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    first = context.Process(target=hold, args=(path, theirs), daemon=True)  # ends with a test that fails
    first.start()
    assert ours.recv() == "held"
    if deed == "renamed":
        (path / "learner.lock").rename(path / "old.lock")
    elif deed != "nothing":
        (path / "learner.lock").unlink()
    with pytest.raises(RunDirError, match="in use by another process"):
        RunDirectory(path).lock("learner.lock", directory=True)
    ours.send("end")
    first.join(10.0)
    RunDirectory(path).lock("learner.lock", directory=True)


def test_the_supervisor_does_not_exclude_its_learner(tmp_path: Path) -> None:
    """`train` locks a file of its own in the folder, and the learner that it starts locks the folder."""
    supervisor, learner = RunDirectory(tmp_path), RunDirectory(tmp_path)
    supervisor.lock("train.lock")
    learner.lock("learner.lock", directory=True)
    with pytest.raises(RunDirError, match="in use"):
        RunDirectory(tmp_path).lock("train.lock")


def test_a_file_system_that_locks_no_folders_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """NFS answers EBADF; the lock file alone has to do there."""

    def refuse(descriptor: object, operation: int) -> None:
        if isinstance(descriptor, int):
            raise OSError(9, "Bad file descriptor")

    monkeypatch.setattr("fcntl.flock", refuse)
    directory = RunDirectory(tmp_path)
    directory.lock("learner.lock", directory=True)
    assert (tmp_path / "learner.lock").read_text() != ""


def test_only_the_end_of_long_metrics_is_read(tmp_path: Path) -> None:
    """The last line decides, whatever stands before it; a line that is longer than any of ours is no end."""
    metrics = tmp_path / "metrics.jsonl"
    end = '{"kind": "end", "time": 1.0, "state": "finished"}\n'
    metrics.write_text('{"kind": "status"}\n' * 20_000 + end)
    assert RunDirectory(tmp_path).finished()
    metrics.write_text(end + '{"kind": "resume"}\n')
    assert not RunDirectory(tmp_path).finished()
    metrics.write_text(end[:-2] + ', "x": "' + "x" * LAST_LINE_BYTES + '"}\n')
    assert not RunDirectory(tmp_path).finished()


def test_a_configuration_that_the_disk_has_damaged_is_one_sentence(tmp_path: Path) -> None:
    """Bytes of config.toml are flipped one at a time: the same configuration, another one, or a typed error."""
    directory, config = RunDirectory(tmp_path), RunConfig(seed=7)
    directory.prepare(config, resume=False)
    path, whole, sentences = tmp_path / "config.toml", to_toml(config).encode(), []
    for place in range(0, len(whole), 17):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << place % 8)]) + whole[place + 1 :])
        with suppress(UsageError):
            directory.prepare(config, resume=True)
            continue
        sentences.append(_complaint(directory, config))
    assert len(sentences) > len(whole) // 17 // 2
    assert all(text.endswith((".", "?")) and "\n" not in text for text in sentences)


def _complaint(directory: RunDirectory, config: RunConfig) -> str:
    with pytest.raises(UsageError) as error:
        directory.prepare(config, resume=True)
    return str(error.value)


def test_a_full_disk_leaves_no_half_configuration(tmp_path, monkeypatch):
    """When there is room again, the same command starts the run."""
    real = Path.write_text

    def full(path, text, **options):
        real(path, text[:40], **options)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(RunDirError, match="No space left"):
        RunDirectory(tmp_path / "run").prepare(RunConfig(), resume=False)
    monkeypatch.undo()
    RunDirectory(tmp_path / "run").prepare(RunConfig(), resume=False)
    assert RunDirectory(tmp_path / "run").configuration() == RunConfig()


def test_runs_that_begin_in_the_same_second_get_folders_of_their_own(tmp_path: Path) -> None:
    """A name that is taken gets a number, so no run is refused because of another."""
    found = [new_folder(tmp_path / "runs", "default-20260101-120000").name for _ in range(3)]
    assert found == ["default-20260101-120000", "default-20260101-120000-2", "default-20260101-120000-3"]


def test_a_place_without_room_for_runs_is_one_sentence(tmp_path: Path) -> None:
    """A folder that cannot be made is a user's mistake."""
    (tmp_path / "file").touch()
    with pytest.raises(RunDirError, match="cannot write into"):
        new_folder(tmp_path / "file" / "runs", "default")


def test_a_run_goes_on_only_with_its_own_team(tmp_path: Path) -> None:
    """An environment that has changed is refused in one sentence; before the run has begun, it may still change."""
    directory, config = RunDirectory(tmp_path / "run"), RunConfig()
    before, after = (TeamSpec((GroupSpec("scout", count, 4, 2),)) for count in (2, 3))
    directory.prepare(config, resume=False)
    directory.adopt(config, after)
    directory.adopt(config, before)
    (tmp_path / "run" / "metrics.jsonl").write_text("{}\n")
    directory.adopt(config, before)
    sentence = r"is for 2 scout agents with 4 inputs \(2 outputs\), but this environment has 3 scout agents with"
    with pytest.raises(RunDirError, match=sentence):
        directory.adopt(config, after)
    wider = TeamSpec((GroupSpec("scout", 2, 4, 3),))
    with pytest.raises(RunDirError, match=r"4 inputs \(2 outputs\), .* 4 inputs \(3 outputs\)"):
        directory.adopt(config, wider)
    (tmp_path / "run" / "team.json").write_text('{"groups": 7}')
    with pytest.raises(RunDirError, match=r"team.json is damaged"):
        directory.adopt(config, before)


LINKS = (
    "learner.lock",
    "train.lock",
    "config.toml.new",
    "metrics.jsonl",
    "policy.safetensors",
    "untrained.safetensors",
    "checkpoints",
    "history",
    "history/learner.jsonl",
    "logs/learner.log",
    "tensorboard",
)


@pytest.mark.parametrize("name", LINKS)
def test_a_run_directory_with_links_is_refused(tmp_path: Path, name: str) -> None:
    """Somebody else's run directory cannot make a resume write outside it: one sentence names the link."""
    directory, outside = tmp_path / "run", tmp_path / "outside"
    config = preset("quick")
    RunDirectory(directory).prepare(config, resume=False)
    outside.mkdir()
    (outside / "file").write_text("mine")
    (directory / name).parent.mkdir(exist_ok=True)
    folder = name in ("checkpoints", "history", "tensorboard")
    (directory / name).symlink_to(outside if folder else outside / "file")
    said = f"{re.escape(str(directory / name))} is a symbolic link"
    with pytest.raises(RunDirError, match=said):
        RunDirectory(directory).prepare(config, resume=True)
    with pytest.raises(RunDirError, match=said):
        RunDirectory(directory).lock("learner.lock", directory=True)
    assert (outside / "file").read_text() == "mine"
    assert [path.name for path in outside.iterdir()] == ["file"]


def test_the_run_directory_itself_may_be_a_link(tmp_path: Path) -> None:
    """Its place is the user's choice."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "elsewhere")
    directory = RunDirectory(tmp_path / "run")
    directory.prepare(preset("quick"), resume=False)
    directory.lock("learner.lock", directory=True)
    assert (tmp_path / "elsewhere" / "learner.lock").exists()
