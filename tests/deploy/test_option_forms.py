"""Help and complaints about options, in the words of people who do not program in Python."""

import re
from collections.abc import Sequence

import pytest

from eia_sec.deploy.cli import dispatch
from tests.deploy.test_cli import complaint


def page(capsys: pytest.CaptureFixture[str], words: Sequence[str]) -> str:
    """Return what a command's help prints."""
    with pytest.raises(SystemExit) as stop:
        dispatch(list(words))
    assert stop.value.code == 0
    return capsys.readouterr().out


def test_help_shows_what_people_set_and_names_the_rest(capsys: pytest.CaptureFixture[str]) -> None:
    """A few screens with the options of the command and the main settings; all of them on request."""
    short, whole = (page(capsys, ["train", word]) for word in ("--help", "--help-all"))
    assert "--help-all shows the other settings" in short
    assert len(short.splitlines()) < len(whole.splitlines()) / 4
    options = [set(re.findall(r"--[\w.-]+", text)) - {"--help-all"} for text in (short, whole)]
    assert {"--preset", "--workers", "--seed", "--env.name", "--algorithm.name", "--learner.device"} < options[0]
    assert options[0] < options[1]
    assert "--farm.battery.power" in options[1] - options[0]
    assert "eia-sec|maddpg|" in short


def test_hidden_settings_are_read(capsys: pytest.CaptureFixture[str]) -> None:
    """What help does not show is an option all the same."""
    assert "epochs must be" in complaint(capsys, "train", "--algorithm.epochs", "-3")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("train --workers two", "--workers must be a whole number, not 'two'. "),
        ("replay --policy greedy --farm x", "--farm must be a whole number, not 'x'. "),
        ("watch --patience soon", "--patience must be a number, not 'soon'. "),
        ("train --algorithm.hindsight monitoring=x", "--algorithm.hindsight must be a number, not 'x'. "),
        ("train --algorithm.hindsight monitoring", "--algorithm.hindsight needs entries KEY=VALUE, "),
        (
            "train --algorithm.memory gruu",
            "must be one of none, gru, not 'gruu'; did you mean gru? ",
        ),
        ("farm save --density unifrm", "patchy, mixed, not 'unifrm'; did you mean uniform? "),
        ("train --epsodes 3", "there is no option --epsodes; did you mean --episodes? "),
        ("farm shwo", "'shwo' was not expected; did you mean show? "),
        ("alive rollout", "missing: NAME. "),
        ("record", "missing: --policy, --out, --env. "),
        ("fleet", "missing: one of check, keys, collect, move-learner, render. "),
        ("trian", "unknown command 'trian'; did you mean train? "),
        ("train --preset quik", "there is no preset 'quik'; did you mean quick? "),
        ("train --algorithm ipo", "not 'ipo'; did you mean ippo?"),
        ("evaluate --policy greddy", "there is no policy 'greddy'; did you mean greedy? "),
    ],
)
def test_complaints_name_what_was_meant(words: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One sentence with the option, what it takes, and what resembles the word that was given."""
    assert said in complaint(capsys, *words.split())


@pytest.mark.parametrize(
    "words", ["evaluate --run-dir", "evaluate --against", "export --run-dir", "replay", "audit", "fly --run-dir"]
)
def test_a_missing_run_directory_has_one_wording(
    words: str, capsys: pytest.CaptureFixture[str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """In every command, and another one where the folder is there and no run is."""
    folder = tmp_path_factory.mktemp("empty")
    assert f"there is no directory {folder}/x." in complaint(capsys, *words.split(), f"{folder}/x")
    assert f"{folder} is not a run directory: it has no " in complaint(capsys, *words.split(), str(folder))
