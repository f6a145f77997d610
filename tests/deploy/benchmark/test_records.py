"""Records of finished trainings."""

import json
import math
from dataclasses import replace

import pytest

from eia_sec.common.errors import EiaSecError
from eia_sec.deploy.benchmark.records import Records
from eia_sec.deploy.benchmark.trainings import RANDOM, Measuring, Training
from tests.deploy.benchmark.examples import MEASURING, base, result

TRAINING = Training("ippo", base(), MEASURING)
RESULT = result(-3.0, -2.0, last=-1.0, best=-2.0, sampled=-1.5)


@pytest.fixture
def records(tmp_path):
    return Records(tmp_path)


def test_a_record_gives_the_result_back(records):
    """A training has no result before its record is written, and then this one."""
    assert records.get(TRAINING) is None
    records.put(TRAINING, RESULT)
    assert records.get(TRAINING) == RESULT
    assert [path.name for path in records.folder.iterdir()] == [f"{TRAINING.name}.json"]


def test_a_reference_has_no_points(records):
    """Random actions are measured at the end alone."""
    reference = replace(TRAINING, algorithm=RANDOM)
    records.put(reference, result(last=-4.0))
    assert records.get(reference) == result(last=-4.0)


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_returns_that_are_not_finite_are_no_result(records, number):
    """They are an error of the training, and nothing is written."""
    with pytest.raises(EiaSecError, match="not finite"):
        records.put(TRAINING, result(-3.0, number))
    assert list(records.folder.iterdir()) == []


def damaged(change):
    held = json.loads(json.dumps(HELD))
    change(held)
    return json.dumps(held)


HELD = {
    "format": 1,
    "training": TRAINING.digest,
    "points": [{"step_count": 400, "seconds": 1.0, "returns": [0.0, 1.0]}] * 2,
    "absolute": [0.0] * 20,
    "final": [0.0] * 20,
    "sampled": [],
    "made": {},
}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        json.dumps(HELD)[:-5],
        damaged(lambda held: held.update(format=2)),
        damaged(lambda held: held.update(training="0")),
        damaged(lambda held: held.pop("final")),
        damaged(lambda held: held["points"].pop()),
        damaged(lambda held: held["points"][0]["returns"].append(1.0)),
        damaged(lambda held: held["points"][0].update(step_count=-1)),
        damaged(lambda held: held["points"][0].update(step_count=1.5)),
        damaged(lambda held: held["points"][0].update(seconds=None)),
        damaged(lambda held: held["final"].pop()),
        damaged(lambda held: held["final"].__setitem__(0, "1")),
        damaged(lambda held: held["final"].__setitem__(0, True)),
        damaged(lambda held: held["final"].__setitem__(0, math.nan)),
        damaged(lambda held: held.update(sampled=[1.0])),
        damaged(lambda held: held.update(made=3)),
    ],
)
def test_what_is_no_record_counts_as_missing(records, text, capfd):
    """The training is done again, and the log says why."""
    records.path(TRAINING).write_text(text)
    assert records.get(TRAINING) is None
    assert "is made anew" in capfd.readouterr().err


def test_the_example_that_was_damaged_is_a_record(records):
    """So each damage above is what makes it none."""
    records.path(TRAINING).write_text(json.dumps(HELD))
    assert records.get(TRAINING) is not None
    assert records.get(replace(TRAINING, measuring=Measuring(2, 3))) is None
