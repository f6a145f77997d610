"""Environments are drawn where they can be, and train on where they cannot."""

import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from eia_sec.common.config import EnvConfig
from eia_sec.common.errors import EnvironmentFaultError
from eia_sec.common.history.history import Drawing, read
from eia_sec.common.protocol.view_checks import MOST_SENTENCE
from eia_sec.rollout.envs import guard, pictures
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(str(HERE))
    yield
    for name in ("toy_env", "toy_pictures"):
        sys.modules.pop(name, None)
    guard._theirs.clear()


def a_batch(how="", name="toy_pictures:Drawn", **more):
    """Return two environments in their first episode, the first of which was asked for pictures."""
    text = "{" + ", ".join([f'"how": "{how}"', *(f'"{key}": {value}' for key, value in more.items())]) + "}"
    batch = PettingZooBatch(EnvConfig(name, text), 2)
    batch.ask_for_pictures(0)
    for index in range(2):
        batch.reset(index, 3, 7)
    return batch


def ended(program, *arguments):
    """Return what has become of a program that knows the environments here."""
    return subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(HERE)!r})\n{program}", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def stepped(batch):
    """Take a step, and return what it led to."""
    batch.step(np.full((2, batch.team.action_size), 0.5, np.float32))
    return batch.reward.copy(), batch.observation.copy()


@pytest.mark.parametrize("name", ["toy_pictures:Drawn", "toy_pictures:any_keywords"])
def test_the_environment_that_was_asked_shows_each_step(name):
    """The first is made anew with a render_mode and shows its state; the other stays as it was."""
    with closing(a_batch(name=name)) as batch:
        assert (batch.picture(0) == 0).all()
        stepped(batch)
        assert batch.picture(0).shape == (6, 9, 3)
        assert (batch.picture(0) == 1).all()
        assert batch.picture(1) is None
        assert batch.silence == ""


def test_an_environment_is_left_alone_until_somebody_asks():
    """Without a question no render_mode is handed over, and nothing is made twice."""
    with closing(PettingZooBatch(EnvConfig("toy_pictures:Drawn", "{}"), 2)) as batch:
        made = list(batch._environments)
        batch.reset(0, 3, 7)
        assert [environment.wrapped.render_mode for environment in made] == [None, None]
        assert batch._environments == made


@pytest.mark.parametrize(
    ("how", "name", "said"),
    [
        ("", "toy_env:Relay", "toy_env:Relay takes no render_mode."),
        (
            "making",
            "toy_pictures:Drawn",
            "render_mode='rgb_array') raised RuntimeError: no display",
        ),
        ("", "toy_pictures:Touchy", "render_mode raised RuntimeError: no mode"),
        ("reset", "toy_pictures:Drawn", "reset() raised RuntimeError: No available video device"),
        ("deaf", "toy_pictures:Drawn", "does not heed render_mode='rgb_array'"),
        ("team", "toy_pictures:Drawn", "has other agents with render_mode='rgb_array'"),
        ("actions", "toy_pictures:Drawn", "has other agents with render_mode='rgb_array'"),
        ("raises", "toy_pictures:Drawn", "render() raised ValueError: no such brush"),
        ("text", "toy_pictures:Drawn", "render() gave 'a picture'; PettingZoo asks for a picture"),
    ],
)
def test_where_no_picture_comes_the_episode_goes_on_and_it_is_said(how, name, said):
    """Whatever is wrong with pictures, rewards and observations are those of an environment that nobody watches."""
    arguments = f'{{"how": "{how}"}}' if how else "{}"
    with (
        closing(PettingZooBatch(EnvConfig(name, arguments), 2)) as watched,
        closing(PettingZooBatch(EnvConfig(name, arguments), 2)) as alone,
    ):
        watched.ask_for_pictures(0)
        for batch in (watched, alone):
            for index in range(2):
                batch.reset(index, 3, 7)
        for _ in range(3):
            assert watched.picture(0) is None
            for found, wanted in zip(stepped(watched), stepped(alone), strict=True):
                np.testing.assert_array_equal(found, wanted)
        assert said in watched.silence
        assert "\n" not in watched.silence
        assert len(watched.silence) <= MOST_SENTENCE
        assert alone.silence == ""


def test_a_step_that_fails_because_of_pictures_ends_the_episode_and_not_the_worker():
    """The episode is truncated with a step that earns nothing; the next one is that of a plain environment."""
    with closing(a_batch("step")) as batch:
        before = stepped(batch)[1]
        batch.step(np.full((2, batch.team.action_size), 0.5, np.float32))
        assert (batch.time.tolist(), batch.ended.tolist(), batch.terminated.tolist()) == (
            [2, 2],
            [True, False],
            [False] * 2,
        )
        assert not batch.reward[0].any()
        np.testing.assert_array_equal(batch.observation[0], before[0])
        assert "step() raised RuntimeError: No available video device" in batch.silence
        batch.reset(0, 3, 8)
        for _ in range(3):
            stepped(batch)
        assert batch.time[0] == 3
        assert batch._environments[0].wrapped.render_mode is None


def test_a_fault_that_has_nothing_to_do_with_pictures_is_one():
    """What raises without a render_mode, too, is not hidden."""
    with closing(a_batch("step", render_mode='"rgb_array"')) as batch:
        stepped(batch)
        with pytest.raises(EnvironmentFaultError, match="No available video device"):
            stepped(batch)


def test_an_environment_is_a_plain_one_again_once_nobody_watches():
    """It is made anew when its next episode begins, and drawn again when somebody asks again."""
    with closing(a_batch()) as batch:
        for ask, mode in ((batch.ask_for_no_pictures, None), (batch.ask_for_pictures, "rgb_array")):
            ask(0)
            before = batch._environments[0]
            stepped(batch)
            assert batch._environments[0] is before
            batch.reset(0, 3, 7)
            assert batch._environments[0].wrapped.render_mode == mode
            assert (batch.picture(0) is None) == (mode is None)


@pytest.mark.parametrize(
    ("how", "name", "notes"),
    [
        ("", "toy_pictures:Drawn", [True, False]),
        ("", "toy_env:Relay", []),
        ("deaf", "toy_pictures:Drawn", [True, False]),
        ("raises", "toy_pictures:Drawn", [True, False]),
    ],
)
def test_it_is_noted_from_when_to_when_an_environment_draws(how, name, notes):
    """Before it is made for pictures, and once the next episode begins without them."""
    noted = []
    with closing(PettingZooBatch(EnvConfig(name, f'{{"how": "{how}"}}' if how else "{}"), 1)) as batch:
        batch.note_drawing = noted.append
        batch.reset(0, 3, 7)
        assert noted == []
        batch.ask_for_pictures(0)
        batch.reset(0, 3, 7)
        batch.picture(0)
        assert noted[:1] == notes[:1]
        batch.ask_for_no_pictures(0)
        batch.reset(0, 3, 7)
        assert noted == notes


@pytest.mark.slow
def test_a_crash_of_the_process_is_noted_before_it_happens(tmp_path):
    """Code in C that aborts leaves nothing behind but what the history says."""
    path = tmp_path / "h.jsonl"
    program = (
        "import sys; from pathlib import Path\n"
        "from eia_sec.common.config import EnvConfig\n"
        "from eia_sec.common.history.history import Drawing, History\n"
        "from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch\n"
        "history = History(Path(sys.argv[1]))\n"
        "batch = PettingZooBatch(EnvConfig('toy_pictures:Drawn', '{\"how\": \"aborts\"}'), 1)\n"
        "batch.note_drawing = lambda drawing: history.add(Drawing(drawing))\n"
        "batch.ask_for_pictures(0)\n"
        "batch.reset(0, 3, 7)\n"
    )
    assert ended(program, str(path)).returncode == -signal.SIGABRT
    assert read(path)[0] == [Drawing(True)]


def test_being_drawn_changes_nothing():
    """Episode after episode, rewards and observations are those of environments that nobody watches."""
    found = []
    for watched in (False, True):
        with closing(PettingZooBatch(EnvConfig("toy_pictures:Drawn", "{}"), 2)) as batch:
            seen = []
            for episode in range(3):
                if watched and episode:
                    batch.ask_for_pictures(0)
                for index in range(2):
                    batch.reset(index, 3, episode)
                while not batch.ended.all():
                    seen.append(np.concatenate([part.ravel() for part in stepped(batch)]))
                    assert (batch.picture(0) is not None) == (watched and episode > 0)
            found.append(np.stack(seen))
    np.testing.assert_array_equal(*found)


def test_the_users_own_render_mode_counts():
    """Where the run's arguments name a mode, it is theirs."""
    with closing(a_batch(render_mode="null")) as batch:
        assert batch.picture(0) is None
        assert "arguments set render_mode" in batch.silence
    with closing(a_batch(render_mode='"rgb_array"')) as batch:
        assert batch.picture(1) is not None


def test_a_picture_that_takes_too_long_is_given_up(monkeypatch):
    """It is interrupted, the next ones are not tried, and the alarm signal is as it was."""
    monkeypatch.setattr(guard, "RENDER_SECONDS", 0.2)
    before = signal.getsignal(signal.SIGALRM)
    with closing(a_batch("hangs")) as batch:
        assert batch.picture(0) is None
        assert "it took longer than 0.2 s" in batch.silence
        assert signal.getsignal(signal.SIGALRM) == before
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
        stepped(batch)
        assert batch.time.tolist() == [1, 1]


def test_an_environment_that_is_not_made_in_time_is_given_up(monkeypatch):
    """Making it for pictures is interrupted, and the plain one goes on."""
    monkeypatch.setattr(pictures, "MAKING_SECONDS", 0.2)
    with closing(a_batch("waits")) as batch:
        assert batch.picture(0) is None
        assert "it took longer than 0.2 s" in batch.silence
        assert batch.time.tolist() == [0, 0]


def test_a_picture_has_so_many_pixels_at_most(monkeypatch):
    """Whatever is larger would take seconds to be made smaller."""
    with closing(a_batch(height=4096, width=4097)) as batch:
        assert batch.picture(0) is None
        assert "PettingZoo asks for a picture" in batch.silence


@pytest.mark.slow
@pytest.mark.parametrize(("how", "method"), [("stubborn", "render()"), ("unbending", "Drawn(")])
def test_a_call_for_watchers_that_nothing_interrupts_ends_the_process(how, method):
    """The watchdog ends the process after PICTURE_SECONDS, although calls have no limit, and notes it."""
    program = (
        "from eia_sec.rollout.envs import guard, pictures, watchdog\n"
        "from tests.rollout.envs import test_pictures\n"
        "guard.RENDER_SECONDS, watchdog.PICTURE_SECONDS, watchdog.PERIOD_SECONDS = 0.1, 0.3, 0.05\n"
        "pictures.MAKING_SECONDS = 0.1\n"
        "watchdog.Watchdog(0.0, lambda: None, timed_out=lambda: print('noted', flush=True))\n"
        f"test_pictures.a_batch({how!r}).picture(0)\n"
    )
    done = ended(program)
    assert done.returncode == 1
    assert "noted" in done.stdout
    assert f"has been in {method}" in done.stderr
