"""What policies earn on farms on which nothing was chosen: means, intervals, and a page of them."""

import numpy as np

from eia_sec.common.config.presets import PRESETS
from research.studies.unseen import COLUMNS, FLOWN, row, scores


def flown(reward, farms=50):
    """Return scores around a reward, the same for each call."""
    noise = np.random.default_rng(0).normal(size=farms)
    return {"reward": (reward + noise).tolist(), "aoi": (0.4 + 0.0 * noise).tolist(), "vdf": [1.7] * farms}


def test_one_policy_has_an_interval_over_farms_and_seeds_over_seeds():
    """Farms differ by one, so their mean by a seventh or so; seeds by as much as their own means."""
    mean, low, high = row("one", [flown(1400.0)], over_seeds=False)["reward"]
    assert low < mean < high
    assert 0.3 < high - low < 0.8
    several = row("several", [flown(1390.0), flown(1400.0), flown(1410.0)], over_seeds=True)
    assert 10.0 < several["reward"][2] - several["reward"][1] <= 20.0
    assert np.ptp([0.4, *several["aoi"]]) < 1e-9


def test_every_policy_flies_on_a_farm_of_its_own_observations():
    """One short flight of the simplest of them gives every field of every farm."""
    assert set(FLOWN.values()) <= set(PRESETS)
    found = scores("lawnmower", "lawnmower", PRESETS["instant"].farm, range(2000, 2002))
    assert {field: len(values) for field, values in found.items()} == dict.fromkeys(COLUMNS, 2)
