"""Where the supply goes."""

from dataclasses import replace

import numpy as np
import pytest

from common.config.presets import PRESETS
from common.errors import ConfigError
from experiments.supply import COLUMNS, KINDS, Ledger, mean, page
from rollout.policies import HEURISTICS
from tests.rollout.small_farm import SMALL


def test_every_unit_is_booked_once():
    """Three counters with a cycle of 2 and a cap of 1 through 6 steps: served in time, at its rise, and never."""
    ledger = Ledger(np.full(3, 2.0), 1.0, np.array([False, False, True]))
    courses = [[0, 1, 0, 1, 1, 1], [0, 0, 0, 1, 1, 1], [0, 1, 1, 1, 1, 1]]
    for step, level in enumerate(np.array(courses, float).T, 1):
        ledger.note(step, level, 1.0 if step == 3 else 0.0)
    assert ledger.told() == {"supply": 9.0, "paid": 1.0, "left": 3.0, "service": 1.0, "cap": 4.0, "border": 2.0}


@pytest.mark.parametrize("name", HEURISTICS)
def test_nothing_is_lost_that_is_not_told(name):
    """Of whoever flies nothing is negative, and who stands still loses most of it at the cap or leaves it."""
    found = mean(replace(SMALL, observation=PRESETS["default"].farm.observation), name, range(2))
    for kind in KINDS:
        own = found[kind]
        assert all(own[column] >= 0.0 for column in COLUMNS)
    if name == "static":
        assert found["VDF of plots"]["paid"] + found["VDF of plots"]["service"] < 0.1 * found["VDF of plots"]["supply"]
    text = page({"command": "x", "commit": "abc", "farms": [0, 1], "results": [found]})
    assert text.count(f"\n| {name} | ") == len(KINDS)


def test_other_cycles_are_refused():
    """Where counters rise at other times than multiples of their cycles, the sums would not say what they say."""
    with pytest.raises(ConfigError, match="multiples of their cycles"):
        mean(replace(SMALL, world=replace(SMALL.world, start_levels="random")), "static", range(1))
