"""Pictures of the studies show what their results hold, on axes on which it can be read."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.deploy.reports import plots
from eia_sec.deploy.reports.plots import FADING, comparison_figure, smooth
from eia_sec.rollout.evaluation import record
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.rendering.palette import COLOURS, END_MARKERS
from research.studies.analysis.paper import REWARD_BY_MEMBERS
from research.studies.flights import described
from research.studies.pages import flight_plots
from research.studies.pages import plots as study_plots
from research.studies.pages.curve_plots import LATE, checks_figure, limits, seeds, training_figure
from research.studies.pages.flight_plots import collected_figure, path_of, space_figure
from research.studies.pages.plots import caption, members_figure, save_pictures, scores_figure

RESULTS = Path(__file__).resolve().parents[3] / "research" / "results" / "reproduce"
STUDIES = ("training", "ablation", "ensemble", "scalability", "inference", "trajectories", "default")
NEEDS_FLIGHTS = re.compile(r"farm-\d+(-collected)?\.png")
"""Pictures of `trajectories` that its results do not hold."""


def run(seed, end, final, *, diverged=False, checks=5):
    """Return a run whose reward grows from -500 to about `final`, or falls to it, as results keep runs."""
    episodes = np.linspace(end / 50, end, 50)
    reward = final - (final + 500.0) * np.exp(-8.0 * episodes / end) + 20.0 * seed
    aoi = 0.5 + 2.0 * np.exp(-8.0 * episodes / end) + 0.01 * seed
    noted = np.linspace(end / checks, end, checks) if checks else []
    return {
        "diverged": diverged,
        "reward": final + 20.0 * seed,
        "curve": {
            "episodes": episodes.tolist(),
            "reward": {name: reward.tolist() for name in ("mean", "communication", "monitoring", "collection")},
            "aoi": aoi.tolist(),
            "vdf": (2.0 * aoi).tolist(),
        },
        "checks": [
            {"episodes": int(at), "reward": final + 20.0 * seed - 1e4 / at, "aoi": 0.4 + 1 / at, "vdf": 2.0 + 1 / at}
            for at in noted
        ],
    }


def study(**methods):
    """Return results of a study with such methods, each a list of runs."""
    return {
        "scale": "full",
        "sizes": {"choice_farms": 20, "farms": 100},
        "methods": {
            name: {"runs": runs, "normalised": [0.9, 0.85, 0.95], "reward": [1000.0, 990.0, 1020.0]}
            for name, runs in methods.items()
        },
    }


@pytest.fixture
def data():
    """Two methods that live, one of them shorter, and one whose runs have all left all bounds."""
    return study(
        one=[run(seed, 800, 1200.0) for seed in range(3)],
        two=[run(seed, 768, 1100.0) for seed in range(3)],
        lost=[run(seed, 40, -4000.0, diverged=True, checks=0) for seed in range(3)],
    )


def lines_of(axes, label):
    return [line for line in axes.lines if line.get_label() == label]


def texts_of(axes):
    return [text.get_text() for text in axes.texts]


def legend_of(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_axes_are_those_of_the_methods_that_live(data):
    """They hold every seed of those, use most of their height for them, and the one that diverged goes out."""
    grid = np.reshape(training_figure(data).axes, (3, 2))
    for axes, name in zip(grid[:2, 0], ("reward", "aoi"), strict=True):
        low, high = axes.get_ylim()
        curves = [method["curve"] for key in ("one", "two") for method in data["methods"][key]["runs"]]
        drawn = np.concatenate([smooth(np.array(c["reward"]["mean"] if name == "reward" else c[name])) for c in curves])
        assert low <= drawn.min() < drawn.max() <= high
        assert np.ptp(drawn) > 0.8 * (high - low)
    axes = grid[0, 0]
    (line,) = lines_of(axes, "lost (3 of 3 diverged)")
    assert line.get_ydata()[-1] < axes.get_ylim()[0] - 1000.0
    (mark,) = [line for line in axes.lines if line.get_marker() == "v"]
    assert mark.get_ydata()[0] == axes.get_ylim()[0]
    first = np.argmax(np.array(line.get_ydata()) < axes.get_ylim()[0])
    assert mark.get_xdata()[0] == line.get_xdata()[first] < 10
    (note,) = texts_of(axes)
    assert re.fullmatch(r"diverged: -39\d\d at episode 40", note)


def test_the_enlarged_panel_holds_the_second_half(data):
    """Every live seed's second half is in its axes, which are a fraction of the whole ones; nothing diverged is."""
    grid = np.reshape(training_figure(data).axes, (3, 2))
    whole, close = (axes.get_ylim() for axes in grid[0])
    assert np.ptp(close) < 0.2 * np.ptp(whole)
    for name in ("one", "two"):
        for held in data["methods"][name]["runs"]:
            curve = held["curve"]
            late = np.array(curve["episodes"]) >= LATE * curve["episodes"][-1] + 40.0
            values = smooth(np.array(curve["reward"]["mean"]))[late]
            assert close[0] <= values.min() <= values.max() <= close[1]
    assert len(grid[0, 1].lines) == 2
    assert grid[0, 0].get_shared_x_axes().joined(grid[0, 0], grid[0, 1])


def test_a_method_that_stays_in_bounds_is_marked_at_its_end():
    """A diverged method that nothing else gives a scale is drawn whole, with a cross where it was cut short."""
    figure = training_figure(study(lost=[run(0, 40, -4000.0, diverged=True)]))
    (cross,) = [line for line in figure.axes[0].lines if line.get_marker() == "X"]
    assert cross.get_xdata()[0] == 40
    low, high = figure.axes[0].get_ylim()
    assert low < cross.get_ydata()[0] < high


def test_training_curves_stand_alone(data):
    """No heuristic, which flew other farms without noise, is beside them, and the note says what is drawn."""
    figure = training_figure(data)
    assert legend_of(figure) == ["one", "two", "lost (3 of 3 diverged)"]
    note = figure.get_suptitle().replace("\n", " ")
    for part in (
        "farms 0..19",
        "with exploration noise",
        "mean of 3 seeds",
        "moving mean over 5%",
        "range of the seeds",
    ):
        assert part in note
    (band,) = [found for found in figure.axes[0].collections[:1]]
    first = [smooth(np.array(held["curve"]["reward"]["mean"])) for held in data["methods"]["one"]["runs"]]
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx(max(values.max() for values in first))
    assert heights.min() == pytest.approx(min(values.min() for values in first))


def test_every_evaluation_on_the_way_is_drawn(data):
    """Each is a point of its method at its episode, the mean of the seeds; the note names the farms."""
    figure = checks_figure(data)
    grid = np.reshape(figure.axes, (3, 2))
    for axes in grid.ravel():
        for name in ("one", "two"):
            (line,) = lines_of(axes, name)
            checks = [held["checks"] for held in data["methods"][name]["runs"]]
            assert line.get_marker() not in ("", "None", None)
            np.testing.assert_array_equal(line.get_xdata(), [check["episodes"] for check in checks[0]])
    for row, key in enumerate(("reward", "aoi", "vdf")):
        (line,) = lines_of(grid[row, 0], "one")
        held = [[check[key] for check in of["checks"]] for of in data["methods"]["one"]["runs"]]
        np.testing.assert_allclose(line.get_ydata(), np.mean(held, axis=0))
    assert "farms 500..519" in figure.get_suptitle()
    assert legend_of(figure)[2] == "lost (3 of 3 diverged before the first point)"


def test_a_seed_that_diverged_is_left_out_and_named(data):
    """The others' mean is drawn, and the legend says how many it is without."""
    data["methods"]["two"]["runs"][2] = run(2, 100, -9e6, diverged=True, checks=1)
    for figure in (training_figure(data), checks_figure(data)):
        (line,) = lines_of(figure.axes[0], "two (1 of 3 diverged)")
        assert line.get_xdata()[-1] == 768
        assert figure.axes[0].get_ylim()[0] > -1e4


def test_methods_without_any_point_leave_empty_axes():
    """Where nothing can be drawn the picture is empty, and the axes have ends."""
    assert limits([], 0.0) == (0.0, 1.0)
    figure = checks_figure(study(lost=[run(0, 40, -4000.0, diverged=True, checks=0)]))
    assert legend_of(figure) == ["lost (1 of 1 diverged before the first point)"]


def test_seeds_in_words():
    """One, as many of each, or from the fewest to the most."""
    runs = [run(seed, 800, 1200.0) for seed in range(5)]
    assert seeds(study(one=runs[:1])) == "1 seed"
    assert seeds(study(one=runs[:3], two=runs[:3])) == "3 seeds"
    assert seeds(study(one=runs[:4], two=runs, three=runs[:3])) == "3 to 5 seeds"


def test_teams_of_all_sizes_are_distinguished():
    """Seven sizes differ in colour, line or mark, and stand in one row, since no half of theirs lies close."""
    runs = [run(seed, 768, 1000.0) for seed in range(3)]
    data = {**study(), "teams": {str(uavs): {"runs": runs} for uavs in (6, 12, 16, 20, 24, 48, 96)}}
    figure = checks_figure(data)
    assert len(figure.axes) == 3
    looks = {(line.get_color(), line.get_marker()) for line in figure.axes[0].lines}
    assert len(looks) == 7
    assert legend_of(figure)[-1] == "96 UAVs"


def test_ratios_stand_beside_the_papers():
    """Each k_s is over that of k_s = 2 for us and for the paper; ours alone are enlarged, with every seed."""
    data = study(**{f"k_s = {k}": [run(seed, 768, 1000.0) for seed in range(3)] for k in (1, 2, 10)})
    data["methods"]["k_s = 10"]["reward"] = [1100.0, 1050.0, 1200.0]
    figure = members_figure(data)
    beside, ratio, alone = figure.axes
    paper = lines_of(ratio, "paper")[0].get_ydata()
    np.testing.assert_allclose(paper, np.array(list(REWARD_BY_MEMBERS.values())) / REWARD_BY_MEMBERS[2])
    ours = ratio.containers[0]
    np.testing.assert_allclose(lines_of(ratio, "ours")[0].get_ydata(), [1.0, 1.0, 1.1])
    np.testing.assert_allclose(ours.lines[2][0].get_segments()[2][:, 1], [1.05, 1.2])
    assert lines_of(alone, "paper") == []
    assert np.ptp(alone.get_ylim()) < 0.6 * np.ptp(beside.get_ylim())
    assert (
        sum(len(line.get_xdata()) for line in alone.lines if line.get_marker() == "_" and line.get_markersize() == 9)
        == 9
    )
    assert legend_of(figure) == ["paper", "ours", "ours, each seed (mean over the farms)"]


@pytest.mark.parametrize("reward", [[1000.0, 1001.0, 1005.0], [-300.0, -320.0, -290.0]])
def test_any_interval_can_be_drawn(data, reward):
    """One that does not hold its value, as the bootstrap of two seeds may not; and ratios to a negative reward."""
    data = study(**{f"k_s = {k}": data["methods"]["one"]["runs"] for k in (1, 2)})
    for method in data["methods"].values():
        method["reward"] = reward
    bars = members_figure(data).axes[0].containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose(bars[0][:, 1], reward[1:])


def test_scores_say_interval_and_divergence(data):
    """A bar may be narrower than its mark, so the numbers stand beside it."""
    figure = scores_figure(data)
    assert texts_of(figure.axes[0]) == ["0.90 (0.85..0.95)"] * 2 + ["0.90 (0.85..0.95)\n3 of 3 diverged"]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["one", "two", "lost"]
    assert "95% interval over 3 seeds and 100 unseen farms" in figure.get_suptitle()


def test_a_score_far_below_all_others_is_marked_at_the_edge(data):
    """The axis is that of the others, the mark a triangle, and the number stands there."""
    data["methods"]["lost"]["normalised"] = [-1.7, -1.9, -1.5]
    figure = scores_figure(data)
    axes = figure.axes[0]
    assert axes.get_xlim()[0] == pytest.approx(-0.25)
    assert [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "<"] == [-0.25]
    assert "-1.70 (-1.90..-1.50)" in texts_of(axes)[2]
    assert "triangle at the left edge" in figure.get_suptitle()


@pytest.fixture(scope="module")
def flown():
    """Two flights over a small farm, field and episode."""
    world = WorldConfig(field_x=120.0, field_y=120.0, sensors=30, sensor_spacing=5.0, plots_x=6, plots_y=6, steps=80)
    config = FarmConfig(world=world)
    return {name: record(config, policy_of(name, config), 1000, 0) for name in ("greedy", "lawnmower")}


def test_paths_in_space_say_how_they_are_drawn(flown):
    """The note gives the stretch of the heights and what the marks are; each path's mark is at its end."""
    config = flown["greedy"].config
    figure = space_figure({name: path_of(flight) for name, flight in flown.items()}, config)
    assert "15 times as tall as lengths: 6 m stand beside 120 m" in figure.get_suptitle()
    assert "A mark is the end of a path" in figure.get_suptitle()
    assert legend_of(figure) == ["communication, 22 m", "monitoring, 20 m", "data collection, 18 m"]
    for axes, flight in zip(figure.axes, flown.values(), strict=True):
        paths, ends = axes.lines[0::2], axes.lines[1::2]
        assert len(paths) == len(ends) == 12
        for agent, (path, end) in enumerate(zip(paths, ends, strict=True)):
            np.testing.assert_array_equal(np.transpose(path.get_data_3d()[:2]), flight.position[:, agent])
            np.testing.assert_array_equal(np.transpose(end.get_data_3d()[:2]), flight.position[-1:, agent])
            assert end.get_marker() in END_MARKERS.values()


def test_paths_in_space_are_drawn_from_results_alike(flown):
    """What results hold of a flight gives the lines of the flight itself, to the decimal that they keep."""
    (flight,) = [flown["greedy"]]
    held = json.loads(json.dumps(described(flight)))
    own, again = (space_figure({"greedy": of}, flight.config).axes[0] for of in (path_of(flight), held))
    assert again.get_title() == own.get_title()
    for one, other in zip(own.lines, again.lines, strict=True):
        np.testing.assert_allclose(one.get_data_3d(), other.get_data_3d(), atol=0.051)


def test_maps_say_that_paths_fade(flown):
    """The pieces of a path grow stronger towards its end, and the legend says so."""
    figure = comparison_figure(flown)
    assert legend_of(figure)[-1] == FADING
    blue = [line for line in figure.axes[0].lines if line.get_color() == COLOURS["communication"]]
    strength = [line.get_alpha() for line in blue if line.get_alpha() is not None][:4]
    assert strength == sorted(strength)
    assert strength[0] < 0.3
    assert strength[-1] > 0.8
    assert len([axes for axes in figure.axes if axes.get_xlabel() == "x, m"]) == 2
    assert [axes.get_xlabel() for axes in figure.axes[2:]] == ["AoI of a sensor, end", "VDF of a plot, end"]


def test_collected_units_are_named(flown):
    """Axes say which units, and every UAV has its line."""
    left, right = collected_figure(flown).axes
    assert [axes.get_ylabel() for axes in (left, right)] == ["VDF units collected so far", "AoI units collected so far"]
    assert len(left.lines) == len(right.lines) == 8


@pytest.mark.parametrize("study", STUDIES)
def test_a_study_is_redrawn_from_its_results_alone(study, tmp_path, monkeypatch):
    """Every picture on its page is drawn again, but those that need the flights; each has a caption."""
    for module in (plots, flight_plots, study_plots):
        monkeypatch.setattr(module, "DPI", 30)  # what is on them does not depend on it
    names = save_pictures(json.loads((RESULTS / study / "results.json").read_text(encoding="utf-8")), tmp_path)
    assert {path.name for path in tmp_path.glob("*.png")} == set(names)
    page = (RESULTS / study / "README.md").read_text(encoding="utf-8")
    shown = [name for name in re.findall(r"!\[.*?\]\((.*?)\)", page) if not NEEDS_FLIGHTS.fullmatch(name)]
    assert names == shown
    assert all((RESULTS / study / name).is_file() for name in shown)
    assert all(caption(name) for name in names)


def test_captions_go_by_the_end_of_the_name():
    """A map, its view in space and what was collected there have the farm's number before the end that names them."""
    maps, space, collected = (caption(f"farm-1000{end}.png") for end in ("", "-3d", "-collected"))
    assert "faint at the beginning" in maps
    assert "taller" in space
    assert "one line for each UAV" in collected
    assert "farms that are neither trained on nor reported" in caption("checks.png")
