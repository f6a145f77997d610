"""Pictures of the studies show what their results hold, on axes on which it can be read."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from eia_sec.deploy.reports import plots
from research.studies.flights import described, flown_again
from research.studies.pages import flight_plots
from research.studies.pages import plots as study_plots
from research.studies.pages.curve_plots import checks_figure, limits, training_figure
from research.studies.pages.plots import caption, members_figure, save_pictures
from research.studies.scales import SCALES

RESULTS = Path(__file__).resolve().parents[3] / "research" / "results" / "reproduce"
STUDIES = ("training", "ablation", "ensemble", "scalability", "inference", "trajectories", "default")


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


def legend_of(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


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


@pytest.mark.parametrize("reward", [[1000.0, 1001.0, 1005.0], [-300.0, -320.0, -290.0]])
def test_any_interval_can_be_drawn(data, reward):
    """One that does not hold its value, as the bootstrap of two seeds may not; and ratios to a negative reward."""
    data = study(**{f"k_s = {k}": data["methods"]["one"]["runs"] for k in (1, 2)})
    for method in data["methods"].values():
        method["reward"] = reward
    bars = members_figure(data).axes[0].containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose(bars[0][:, 1], reward[1:])


@pytest.mark.parametrize("study", STUDIES)
def test_a_study_is_redrawn_from_its_results_alone(study, tmp_path, monkeypatch):
    """Every picture on its page is drawn again; each has a caption."""
    for module in (plots, flight_plots, study_plots):
        monkeypatch.setattr(module, "DPI", 30)  # what is on them does not depend on it
    names = save_pictures(json.loads((RESULTS / study / "results.json").read_text(encoding="utf-8")), tmp_path)
    assert {path.name for path in tmp_path.glob("*.png")} == set(names)
    page = (RESULTS / study / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"!\[.*?\]\((.*?)\)", page)
    assert names == shown
    assert all((RESULTS / study / name).is_file() for name in shown)
    assert all(caption(name) for name in names)


def test_a_flight_is_flown_again_as_it_was():
    """Ages and collected units, which depend on all places before, are those that the study found."""
    data = json.loads((RESULTS / "trajectories" / "results.json").read_text(encoding="utf-8"))
    (farm, held), *_ = data["farms"].items()
    for flight in held.values():
        again = described(flown_again(SCALES[data["scale"]].base().farm, int(farm), flight))
        names = ("reward", "aoi", "vdf", "collected", "supplied", "visited")
        assert {name: again[name] for name in names} == {name: flight[name] for name in names}
