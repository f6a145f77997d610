"""Where sensors stand: a pure function of the seed, spaced, irregular, balanced in types."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from eia_sec.common.config import FarmConfig, ObservationConfig, WorldConfig
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.sim.layout import make_layout


def spacing(xy: np.ndarray) -> float:
    return float(cKDTree(xy).query(xy, k=2)[0][:, 1].min())


def test_a_layout_is_a_pure_function_of_its_seed():
    """Equal for equal seeds, also when made anew; another for another seed."""
    first = make_layout.__wrapped__(FarmConfig(), 7)
    again = make_layout.__wrapped__(FarmConfig(), 7)
    for name in ("sensor_xy", "sensor_type", "sensor_cycle_steps", "cell_start"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.sensor_xy, make_layout(FarmConfig(), 8).sensor_xy)


@pytest.mark.parametrize(
    ("sensors", "side", "apart"), [(400, 400.0, 10.0), (1, 50.0, 10.0), (200, 400.0, 0.0), (900, 400.0, 9.0)]
)
def test_sensors_are_spaced_and_inside(sensors, side, apart):
    """Exactly as many as asked for, at least the spacing apart, all in the field."""
    world = WorldConfig(sensors=sensors, field_x=side, field_y=side * 1.5, sensor_spacing=apart)
    for seed in range(5):
        xy = make_layout(FarmConfig(world=world, observation=ObservationConfig(sensors=1)), seed).sensor_xy
        assert xy.shape == (sensors, 2)
        assert ((xy >= 0.0) & (xy <= (side, side * 1.5))).all()
        if sensors > 1:
            assert spacing(xy) >= apart


def test_ten_thousand_sensors_find_their_places():
    """On a field of the same density."""
    layout = make_layout(FarmConfig(world=WorldConfig(sensors=10_000, field_x=2000.0, field_y=2000.0)), 0)
    assert len(layout.sensor_xy) == 10_000
    assert spacing(layout.sensor_xy) >= 10.0


def test_density_is_irregular_and_differs_between_farms():
    """Counts in a 4 x 4 raster spread more than evenly sampled sensors would, and not alike on two farms."""
    counts = [np.histogram2d(*make_layout(FarmConfig(), seed).sensor_xy.T, bins=4)[0].ravel() for seed in range(6)]
    for count in counts:
        assert count.std() > np.sqrt(25.0)
    assert abs(np.corrcoef(counts)[np.triu_indices(6, 1)]).min() < 0.5


def test_types_are_balanced_and_set_the_cycle():
    """133 or 134 sensors of each of three types, scattered, with cycles 40, 50 and 60 s."""
    layout = make_layout(FarmConfig(world=WorldConfig(step_seconds=0.5)), 0)
    assert sorted(np.bincount(layout.sensor_type).tolist()) == [133, 133, 134]
    np.testing.assert_array_equal(layout.sensor_cycle_steps, np.array([80, 100, 120])[layout.sensor_type])
    assert (np.diff(layout.sensor_type) != 0).mean() > 0.5


def test_sensors_are_numbered_cell_by_cell():
    """The kernel finds all sensors of a cell between its start and the next."""
    layout = make_layout(FarmConfig(), 3)
    columns, rows = layout.cells
    for cell in range(columns * rows):
        members = layout.sensor_xy[layout.cell_start[cell] : layout.cell_start[cell + 1]]
        assert (members[:, 0] // (400.0 / columns) == cell // rows).all()
        assert (members[:, 1] // (400.0 / rows) == cell % rows).all()
    assert layout.cell_start[-1] == 400


def test_layouts_cannot_be_written_to():
    """All callers that ask for the same farm share them."""
    with pytest.raises(ValueError, match="read-only"):
        make_layout(FarmConfig(), 0).sensor_xy[0] = 0.0


def test_sensors_that_cannot_fit_are_refused_in_one_sentence():
    """Ten thousand sensors ten metres apart do not fit into 400 m x 400 m."""
    with pytest.raises(ConfigError, match="do not fit") as error:
        make_layout(FarmConfig(world=WorldConfig(sensors=10_000)), 0)
    assert str(error.value).count(".") == 1
