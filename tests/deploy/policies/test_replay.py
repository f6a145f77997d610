"""A replay shows the episode that an evaluation flies, side by side, and films are written picture by picture."""

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from eia_sec.common.config.files import to_toml
from eia_sec.common.errors import EiaSecError, UsageError
from eia_sec.common.policy_file import POLICY, save_policy
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.commands.policies import replay as command
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.policies.replay import Comparison, paper_pictures, scenes_of
from eia_sec.deploy.reports import film
from eia_sec.deploy.reports.film import Film, find_ffmpeg
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.rendering.side_by_side import SideBySidePicture
from tests.deploy.monitor.web.stage import CONFIG, some_actors

WORLD = CONFIG.farm.world
BOTH = Comparison(CONFIG.farm, ("greedy", "lawnmower"), ("one", "other"), 1003, 1)


@pytest.fixture
def ffmpeg():
    """The program; tests that need it are skipped where there is none."""
    try:
        return find_ffmpeg()
    except UsageError as error:
        pytest.skip(str(error))


def decoded(ffmpeg: str, path: Path, width: int, height: int) -> np.ndarray:
    """Return a film's pictures [F, H, W, 3]."""
    raw = subprocess.run(
        [ffmpeg, "-loglevel", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
        capture_output=True,
        check=True,
    ).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3)


def test_both_fly_the_episode_that_an_evaluation_flies():
    """Both start in the same places and end with the rewards that `evaluate` reports for the same farm and episode."""
    scenes = list(scenes_of(BOTH))
    assert [scene.step for scene, _ in scenes] == list(range(WORLD.steps + 1))
    np.testing.assert_array_equal(scenes[0][0].position, scenes[0][1].position)
    assert np.abs(scenes[-1][0].position - scenes[-1][1].position).max() > 1.0
    for which, name in enumerate(BOTH.policies):
        flown = evaluate(CONFIG.farm, policy_of(name, CONFIG.farm), [1003], 2, name=name)
        first = evaluate(CONFIG.farm, policy_of(name, CONFIG.farm), [1003], 1, name=name)
        second = 2.0 * flown.total.reward - first.total.reward
        assert scenes[-1][which].reward["mean"] == pytest.approx(second)


def test_the_picture_shows_each_farm_on_its_own_side():
    """What moves on one farm changes its map and not the other one."""
    scenes = [scenes for scenes, _ in zip(scenes_of(BOTH), range(10), strict=False)]
    picture = SideBySidePicture(BOTH.names, scenes[0])
    for pair in scenes:
        picture.note(pair)
    same, left = picture.draw((scenes[9][0], scenes[9][1])), picture.draw((scenes[5][0], scenes[9][1]))
    assert same.shape == (picture.size[1], picture.size[0], 3) == (900, 1600, 3)
    changed = np.flatnonzero((same != left)[70:660].any(axis=(0, 2)))
    assert changed.size > 0
    assert changed.min() >= 40
    assert changed.max() < 680


def test_a_film_holds_the_pictures_in_order(tmp_path, ffmpeg):
    """The file holds exactly the frames that were added, and the folder holds nothing else."""
    path = tmp_path / "new" / "film.mp4"
    levels = (0, 128, 255)
    with Film(path, (64, 48), 10.0) as reel:
        for level in levels:
            reel.add(np.full((48, 64, 3), level, np.uint8))
        assert not path.exists()
    assert [entry.name for entry in path.parent.iterdir()] == ["film.mp4"]
    read = decoded(ffmpeg, path, 64, 48)
    np.testing.assert_allclose(read.mean(axis=(1, 2, 3)), levels, atol=4)


def test_an_animated_gif_is_smaller_and_whole(tmp_path, ffmpeg, monkeypatch):
    """A GIF is scaled to its width and has as many pictures as were added."""
    monkeypatch.setitem(film.CODECS, ".gif", tuple(text.replace("960", "32") for text in film.CODECS[".gif"]))
    with Film(tmp_path / "film.gif", (64, 48), 5.0) as reel:
        for level in (10, 200, 90):
            reel.add(np.full((48, 64, 3), level, np.uint8))
    read = decoded(ffmpeg, tmp_path / "film.gif", 32, 24)
    np.testing.assert_allclose(read.mean(axis=(1, 2, 3)), (10, 200, 90), atol=3)


def filmed(path, size, pictures):
    with Film(path, size, 10.0) as reel:
        for picture in pictures:
            reel.add(picture)


def test_a_film_that_fails_leaves_nothing(tmp_path, ffmpeg):
    """An error on the way, and an encoder that gives up, leave no file; a picture of another size is refused."""
    black, odd = np.zeros((48, 64, 3), np.uint8), np.zeros((48, 63, 3), np.uint8)
    with pytest.raises(ZeroDivisionError):
        filmed(tmp_path / "a.mp4", (64, 48), (black // (1 // step) for step in (1, 0)))
    with pytest.raises(EiaSecError, match="the film is"):
        filmed(tmp_path / "b.mp4", (64, 48), [black, odd])
    with pytest.raises(EiaSecError, match="could not be written"):
        filmed(tmp_path / "c.mp4", (63, 48), [odd] * 200)
    assert list(tmp_path.iterdir()) == []


def test_the_command_makes_film_and_pictures(tmp_path, ffmpeg, capsys):
    """From a configuration and two policies' names come an MP4, a PNG and a PDF under the farm's name."""
    (tmp_path / "tiny.toml").write_text(to_toml(CONFIG), encoding="utf-8")
    words = [
        "--policy",
        "greedy",
        "--against",
        "static",
        "--farm",
        "1002",
        "--every",
        "20",
        "--out",
        str(tmp_path / "made"),
    ]
    assert run_command(lambda: dispatch(["replay", *words, "--config", str(tmp_path / "tiny.toml")])) == 0
    made = tmp_path / "made"
    assert {path.name for path in made.iterdir()} == {"farm-1002.mp4", "farm-1002.png", "farm-1002.pdf"}
    assert (made / "farm-1002.pdf").read_bytes().startswith(b"%PDF")
    assert imread(made / "farm-1002.png").std() > 0.1
    read = decoded(ffmpeg, made / "farm-1002.mp4", 1600, 900)
    assert len(read) == 3
    assert np.abs(read[0].astype(int) - read[2]).mean() > 1.0
    assert capsys.readouterr().out.count("written:") == 3


def test_a_run_is_replayed_with_its_own_policy(tmp_path, ffmpeg, capsys):
    """Of a run's directory its configuration and its saved actors are flown, on the farm that is asked for."""
    run = tmp_path / "mine"
    short = replace(CONFIG, farm=replace(CONFIG.farm, world=replace(WORLD, steps=12)))
    RunDirectory(run).prepare(short, resume=False)
    save_policy(run / POLICY, some_actors(), {"seed": "0"})
    words = ["replay", str(run), "--farm", "1004", "--film", "gif", "--every", "4"]
    assert run_command(lambda: dispatch(words)) == 0
    made = run / "replay"
    assert {path.name for path in made.iterdir()} == {"farm-1004.gif", "farm-1004.png", "farm-1004.pdf"}
    written = capsys.readouterr().out
    assert all(str(path) in written for path in made.iterdir())
    read = decoded(ffmpeg, made / "farm-1004.gif", 960, 540)
    assert len(read) == 1 + 12 // 4
    shown = imread(made / "farm-1004.png")
    other = tmp_path / "other.png"
    flown = Comparison(short.farm, (str(run / POLICY), "lawnmower"), ("mine", "lawnmower"), 1004, 0)
    paper_pictures(flown, [other])
    np.testing.assert_array_equal(shown, imread(other))
    paper_pictures(replace(flown, policies=("static", "lawnmower")), [other])
    assert np.abs(shown - imread(other)).max() > 0.1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "a run directory or --policy"),
        (["nowhere"], "there is no directory nowhere"),
        (["--policy", "best"], "no policy 'best'"),
        (["--policy", "static", "--against", "best", "--film", "none"], "no policy 'best'"),
        (["--policy", "static", "--farm", "-1"], "farm must be"),
        (["--policy", "static", "--every", "0"], "every must be"),
        (["--policy", "static", "--rate", "0"], "--rate must be"),
        (["--policy", "static", "--film", "avi"], "avi"),
    ],
)
def test_mistakes_are_one_sentence(words, said, capsys, tmp_path, monkeypatch):
    """What cannot be replayed is said in one sentence, exit code 2, and nothing is made."""
    monkeypatch.chdir(tmp_path)
    assert run_command(lambda: dispatch(["replay", *words])) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_without_ffmpeg_it_says_what_to_install(capsys, monkeypatch, tmp_path):
    """Where there is no ffmpeg the sentence names the extra, before anything is flown."""

    def none():
        raise ImportError

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(film.importlib, "import_module", lambda _: none())
    monkeypatch.setattr(film.shutil, "which", lambda _: None)
    monkeypatch.delenv("IMAGEIO_FFMPEG_EXE", raising=False)
    assert command.find_ffmpeg is find_ffmpeg
    with pytest.raises(UsageError, match="replay"):
        find_ffmpeg()
    assert capsys.readouterr().err == ""
