"""Trainings of benchmarks as files."""

from dataclasses import replace

import pytest

from eia_sec.common import regular_files
from eia_sec.common.config.files import with_values
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.deploy.benchmark.trainings import RANDOM, Measuring, Training
from tests.deploy.benchmark.examples import COVER, MEASURING, base

TRAINING = Training("ippo", base(), MEASURING)


def test_a_file_holds_the_training_itself(tmp_path):
    """What its process reads is what was written."""
    path = tmp_path / "job.json"
    path.write_text(TRAINING.to_json())
    assert Training.from_file(path) == TRAINING


def test_everything_that_decides_the_outcome_is_in_the_name():
    """A setting, a seed, an algorithm, or what is measured gives another name; so nothing stale is taken for done."""
    others = [
        TRAINING,
        replace(TRAINING, algorithm=RANDOM),
        replace(TRAINING, config=with_values(TRAINING.config, {"seed": 1})),
        replace(TRAINING, config=with_values(TRAINING.config, {"algorithm.hidden": 17})),
        replace(TRAINING, measuring=Measuring(3, 2)),
        replace(TRAINING, measuring=Measuring(2, 3)),
    ]
    assert len({one.name for one in others}) == len(others)
    assert TRAINING.name.startswith("ippo-mytask-env-Cover-0-")
    assert TRAINING.label == f"ippo on {COVER}, seed 0"
    assert others[1].label == f"random on {COVER}"


def test_training_and_evaluations_share_no_scenario():
    """Scenarios of training, of the points and of the end are three sets."""
    config, measuring = base(), Measuring(2, 5)
    seen = set(range(config.rollout.train_farms)), set(measuring.along(config)), set(measuring.final(config))
    assert [len(one) for one in seen[1:]] == [5, 50]
    assert len(set.union(*seen)) == sum(map(len, seen))


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", '{"algorithm": "ippo"}', TRAINING.to_json().replace('"points": 2', '"points": "2"')],
)
def test_other_files_are_refused(tmp_path, text):
    """A file that holds no training is one sentence."""
    path = tmp_path / "job.json"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"is not a training of a benchmark"):
        Training.from_file(path)


def test_a_file_that_is_too_large_is_refused(tmp_path, monkeypatch):
    """No more is read than a benchmark writes."""
    monkeypatch.setattr(regular_files, "MOST_TEXT_BYTES", 10)
    path = tmp_path / "job.json"
    path.write_text(TRAINING.to_json())
    with pytest.raises(UsageError, match="more than 10 bytes"):
        Training.from_file(path)


@pytest.mark.parametrize(("points", "scenarios"), [(0, 1), (1, 0), (1001, 1), (1, 1001)])
def test_impossible_measuring_is_refused(points, scenarios):
    """There is at least one point and one scenario, and neither are too many."""
    with pytest.raises(ConfigError, match="must be between"):
        Measuring(points, scenarios)
