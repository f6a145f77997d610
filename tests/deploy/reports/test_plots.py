import io
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from rich.console import Console

from eia_sec.common.config import BatteryConfig, FarmConfig, StressConfig, WorldConfig, ZoneConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.farm import EPISODE_METRICS, METRIC_NAMES, farm_environment
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import EpisodeSummary
from eia_sec.deploy.reports.comparison_tables import comparison_table
from eia_sec.deploy.reports.plots import (
    COLOURS,
    comparison_figure,
    curves,
    curves_figure,
    trajectories_figure,
)
from eia_sec.rollout.evaluation import Evaluation, Score, Trajectory
from eia_sec.rollout.rendering.palette import SOIL_STOPS, rgb
from eia_sec.rollout.sim.stations import station_places


def metrics(count=40):
    records = [{"kind": "throughput", "rate": 1.0}]
    for index in range(count):
        reward = {"communication": -100.0, "monitoring": 10.0 * index, "collection": 5.0 * index, "mean": 4.0 * index}
        records.append({"kind": "episodes", "episodes": 8 * index, "reward": reward, "aoi": 2.0, "vdf": 3.0})
    return [*records, {"kind": "imitation", "episodes": 10, "event": 1}, {"kind": "imitation", "episodes": 20}]


@pytest.fixture
def trajectory():
    generator = np.random.default_rng(0)
    world = WorldConfig(communication_uavs=1, monitoring_uavs=2, collection_uavs=1, sensors=30, plots_x=4, plots_y=5)
    return Trajectory(
        config=FarmConfig(world=world),
        farm=1000,
        episode=0,
        position=generator.uniform(0.0, 400.0, (21, 4, 2)),
        assignment=np.array([0, 0, 0]),
        sensor_xy=generator.uniform(0.0, 400.0, (30, 2)),
        sensor_type=np.arange(30) % 3,
        aoi=np.ones(21),
        vdf=np.ones(21),
        collected=np.zeros((21, 4)),
        final_aoi=generator.integers(0, 6, 30).astype(float),
        final_vdf=np.arange(20.0).reshape(4, 5) % 6,
        summary=EpisodeSummary(1000, 1, 20, (1.0, 2.0, 3.0, 4.0), {"aoi": 1.5, "vdf": 2.5}),
    )


def evaluation(name, reward):
    score = Score(
        reward,
        {"communication": -120.0, "monitoring": 1500.4, "collection": 1300.0},
        500.0,
        dict(zip(METRIC_NAMES, (1.234, 2.345, 0.25, 1.0, 12345.0), strict=True)),
    )
    return Evaluation(name, (1000, 1001), 1, score, (score, score), farm_environment(FarmConfig()))


def texts(axes):
    return [text.get_text() for text in axes.texts]


def labels(axes):
    return {text.get_text() for text in axes.get_legend().get_texts()}


def width_of(path):
    return matplotlib.image.imread(path).shape[1]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_curves_of_a_run_that_hardly_began(count, tmp_path):
    """No, one or two records still make a picture, and a single record is a visible dot."""
    curves(metrics(count), tmp_path / "curves.png", {"lawnmower": 895.0}, EPISODE_METRICS)
    assert width_of(tmp_path / "curves.png") >= 1000
    lowest = curves_figure(metrics(count), {}, EPISODE_METRICS).axes[-1]
    dots = [line for line in lowest.lines if line.get_marker() == "o"]
    assert bool(dots) == (count == 1)


def test_the_mean_has_a_panel_of_its_own():
    """Types are beside each other in the next one; a team of one type has no such panel, and the title says whose."""
    figure = curves_figure(metrics(), {"lawnmower": 95.0}, EPISODE_METRICS, "first: ippo, seed 0")
    assert figure.get_suptitle() == "first: ippo, seed 0"
    assert labels(figure.axes[0]) == {"all agents", "imitation"}
    assert labels(figure.axes[1]) == {"communication", "monitoring", "data collection"}
    alone = [{"kind": "episodes", "episodes": 1, "reward": {"mean": 1.0, "a": 1.0}, "steps": 9}]
    assert len(curves_figure(alone).axes) == 2


def test_map_shows_the_last_steps_alone(trajectory):
    """Longer paths would cover the map; the legend says how far back they begin."""
    walk = np.cumsum(np.ones((301, 4, 2)), axis=0)
    axes, key, *_ = trajectories_figure(replace(trajectory, position=walk)).axes
    assert max(len(line.get_xdata()) for line in axes.lines) == 101
    assert "UAV 100 steps before" in labels(key)
    np.testing.assert_allclose(axes.images[0].cmap(1.0), (*np.array(rgb(SOIL_STOPS[-1])) / 255, 1.0), atol=0.01)


def test_map_shows_plots_sensors_paths_and_links(trajectory):
    """The map holds the VDF image, every sensor by type and AoI, every UAV's path and every relay link."""
    axes = trajectories_figure(trajectory).axes[0]
    np.testing.assert_array_equal(axes.images[0].get_array(), trajectory.final_vdf.T)
    assert [len(sensors.get_offsets()) for sensors in axes.collections] == [10, 10, 10]
    np.testing.assert_array_equal(axes.collections[1].get_array(), trajectory.final_aoi[trajectory.sensor_type == 1])
    paths = [line for line in axes.lines if len(line.get_xdata()) == 21]
    for agent, name in enumerate(("communication", "monitoring", "monitoring", "collection")):
        assert paths[agent].get_color() == COLOURS[name]
        np.testing.assert_array_equal(paths[agent].get_xydata(), trajectory.position[:, agent])
    links = [line.get_xydata() for line in axes.lines if line.get_linestyle() == ":"]
    np.testing.assert_array_equal(links, [trajectory.position[-1, [0, served]] for served in (1, 2, 3)])
    assert "100 m" in texts(axes)


def test_map_shows_stations_areas_and_zones(trajectory):
    """Each is drawn where it is and has its symbol in the legend, of one map and of two side by side."""
    square = ((10.0, 10.0), (60.0, 10.0), (60.0, 60.0), (10.0, 60.0))
    config = replace(
        trajectory.config,
        battery=BatteryConfig(capacity=8000.0, stations=3),
        stress=StressConfig(areas=((4, square),)),
        zones=ZoneConfig((square,)),
    )
    with_all = replace(trajectory, config=config)
    axes, key, *_ = trajectories_figure(with_all).axes
    drawn = {collection.get_label(): collection for collection in axes.collections}
    np.testing.assert_allclose(drawn["charging station"].get_offsets(), station_places(config))
    for name in ("area of faster growth", "no-fly zone"):
        assert {tuple(corner) for corner in drawn[name].get_paths()[0].vertices} == set(square)
    wanted = {"charging station", "area of faster growth", "no-fly zone"}
    assert wanted < labels(key)
    (legend,) = comparison_figure({"a": with_all, "b": with_all}).legends
    assert wanted < {text.get_text() for text in legend.get_texts()}


def test_table_keeps_numbers_whole_beside_a_long_path():
    """In a terminal of 80 columns the path of a policy goes over several lines, and no cell is cut."""
    console, path = Console(file=io.StringIO(), width=80), "runs/" + 4 * "a-long-name/" + "policy.safetensors"
    console.print(comparison_table([evaluation(path, 901.0)], "farm"))
    text = console.file.getvalue()
    assert "\u2026" not in text
    assert {"901", "-120", "1500", "1300", "1.23", "2.35"} <= set(text.split())
    heading, _, _ = text.partition("reward per agent")
    assert path in "".join(heading.replace("mean per episode", "").split()).partition("each")[2]


def test_table_names_every_row_with_its_unit():
    """Types by their whole names, metrics with units, policies in the order given, in a terminal of 80 columns."""
    console = Console(file=io.StringIO(), width=80)
    policies = [evaluation("lawnmower", 895.2), evaluation("EIA-SEC (this run)", 901.0)]
    console.print(comparison_table(policies, "farm"))
    lines = [line.split() for line in console.file.getvalue().splitlines()]
    assert " ".join(lines[0]) == "2 farms (1000 to 1001), 1 episode each"
    assert lines[1] == ["mean", "per", "episode", "lawnmower", "EIA-SEC", "(this", "run)"]
    assert lines[3:] == [
        ["reward", "per", "agent", "895", "901"],
        ["communication", "-120", "-120"],
        ["monitoring", "1500", "1500"],
        ["collection", "1300", "1300"],
        ["AoI,", "units", "1.23", "1.23"],
        ["VDF,", "units", "2.35", "2.35"],
        ["collisions,", "UAV", "steps", "0.2", "0.2"],
        ["boundary,", "UAV", "steps", "1.0", "1.0"],
        ["energy,", "kJ", "12", "12"],
    ]


def test_other_environments_have_their_own_rows():
    """Types by their names, small rewards with decimals, and the length of episodes where there are no farm metrics."""
    runners = TeamSpec((GroupSpec("runner", 1, 2, 2), GroupSpec("chaser", 1, 2, 2)))
    score = Score(-1.234, {"runner": -1.0, "chaser": -2.5}, 25.0, {})
    console = Console(file=io.StringIO(), width=80)
    found = Evaluation("random", (1,), 2, score, (score,), EnvironmentSpec(runners, (25, 25)))
    console.print(comparison_table([found], "scenario"))
    lines = [" ".join(line.split()) for line in console.file.getvalue().splitlines()]
    assert lines[0] == "1 scenario (1), 2 episodes each"
    assert lines[3:] == ["reward per agent -1.23", "runner -1.00", "chaser -2.50", "length, steps 25"]
