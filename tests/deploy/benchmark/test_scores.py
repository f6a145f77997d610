"""Scores of a benchmark, its page and its pictures, from results that are known."""

import numpy as np
import pytest

from eia_sec.deploy.benchmark.figures import curves_figure, scores_figure
from eia_sec.deploy.benchmark.page import environment_table, overall_table, page
from eia_sec.deploy.benchmark.scores import Scores, absolute, final, sampled
from tests.deploy.benchmark.examples import COVER, MADE, plan, result

OTHER = "mpe2:simple_spread_v3"


@pytest.fixture
def scores():
    """Two algorithms, two environments and two seeds; in the other environment everything is ten times as large."""
    own = plan(COVER, OTHER)
    found = {}
    for one in own.references:
        found[one.name] = result(last=-5.0 if one.config.env.name == COVER else -50.0)
    for one in own.trainings:
        scale = 1.0 if one.config.env.name == COVER else 10.0
        better = float(one.config.seed) + (2.0 if one.algorithm == "mappo" else 0.0)
        parts = {"last": scale * (better - 3.0), "best": scale * (better - 2.0)}
        drawn = None if one.algorithm == "mappo" else scale * (better - 4.0)
        found[one.name] = result(scale * (better - 4.0), scale * (better - 3.0), **parts, sampled=drawn)
    return Scores(own, found)


def test_intervals_are_over_the_seeds(scores):
    """Of two seeds, the interquartile mean is their mean, and the interval reaches from one to the other."""
    assert scores.interval("ippo", COVER, final) == (-2.5, -3.0, -2.0)
    assert scores.interval("mappo", OTHER, absolute) == (5.0, 0.0, 10.0)
    assert scores.interval("ippo", COVER, sampled) == (-3.5, -4.0, -3.0)
    assert scores.interval("mappo", COVER, sampled) is None
    assert scores.random(OTHER) == -50.0


def test_environments_count_alike_on_the_normalised_scale(scores):
    """Each is scaled by its own lowest and highest episode, so that ten times the reward is no more."""
    assert scores.bounds(COVER) == (-4.0, 1.0)
    assert scores.bounds(OTHER) == (-40.0, 10.0)
    value, low, high = scores.normalised("ippo", final)
    assert value == pytest.approx(0.3)
    assert (low, high) == pytest.approx((0.2, 0.4))


def test_a_curve_has_each_point_with_its_interval(scores):
    """Points stand at the steps that were taken."""
    steps, found = scores.curve("ippo", COVER)
    np.testing.assert_array_equal(steps, [400.0, 800.0])
    np.testing.assert_allclose(found, [[-3.5, -2.5], [-4.0, -3.0], [-3.0, -2.0]])


def test_marl_eval_finds_its_layout(scores):
    """Environment, task, algorithm, seed and step, the absolute metric last, as its README describes it."""
    found = scores.marl_eval()
    assert {name: list(tasks) for name, tasks in found.items()} == {
        "mytask.env": ["cover"],
        "mpe2": ["simple_spread_v3"],
    }
    runs = found["mytask.env"]["cover"]["ippo"]
    assert list(runs) == ["seed_0", "seed_1"]
    assert list(runs["seed_1"]) == ["step_0", "step_1", "absolute_metrics"]
    assert runs["seed_1"]["step_1"] == {"step_count": 800, "return": [-2.0, -2.0]}
    assert runs["seed_1"]["absolute_metrics"] == {"return": [-1.0] * 20}


def test_tables_have_the_best_first(scores):
    """An algorithm has a row, with an empty cell for what it does not have; random actions stand last."""
    assert environment_table(scores, COVER) == [
        "| algorithm | at the end | drawn actions | best on the way | minutes a run |",
        "|---|---:|---:|---:|---:|",
        "| mappo | -0.50 (-1.00 to 0.00) |  | 0.50 (0.00 to 1.00) | 0.0 |",
        "| ippo | -2.50 (-3.00 to -2.00) | -3.50 (-4.00 to -3.00) | -1.50 (-2.00 to -1.00) | 0.0 |",
        "| random | -5.00 |  |  |  |",
    ]
    assert [row.split(" | ")[0] for row in overall_table(scores)[2:]] == ["| mappo", "| ippo"]


def test_the_page_says_what_made_it(scores):
    """Command, commit, versions, and the command of a single run stand on it, and how few seeds there are."""
    text = page(scores, {**MADE, "command": "eia-sec benchmark --algorithms ippo,mappo"}, ["--algorithm.hidden=16"])
    assert "\neia-sec benchmark --algorithms ippo,mappo\n" in text
    assert "Commit abc1234, Python 3.11.9, torch 2.6.0." in text
    single = (
        "eia-sec train --lockstep --env mytask.env:Cover --algorithm.hidden=16 --algorithm ippo --seed 0 --steps 800"
    )
    assert f"\n{single}\n" in text
    assert "With fewer than 5 seeds the intervals are too narrow" in text
    assert "took 800 environment steps" in text
    assert "on 20 scenarios that training never saw" in text
    assert all(f"({name})" in text for name in ("curves.png", "scores.png"))


def test_curves_show_every_algorithm_and_random_actions(scores):
    """A panel for each environment; lines are the interquartile means."""
    figure = curves_figure(scores)
    assert [axes.get_title("left") for axes in figure.axes] == [COVER, OTHER]
    lines = {line.get_label(): line for line in figure.axes[0].get_lines()}
    assert set(lines) == {"ippo", "mappo", "random"}
    np.testing.assert_allclose(lines["ippo"].get_xydata(), [[400.0, -3.5], [800.0, -2.5]])
    assert set(lines["random"].get_ydata()) == {-5.0}
    looks = [(line.get_color(), line.get_linestyle(), line.get_marker()) for line in lines.values()]
    assert len(set(looks)) == 3
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == (-4.0, -2.0)


def test_bars_show_every_environment_and_all_together(scores):
    """A row for each algorithm, with its interval."""
    figure = scores_figure(scores)
    assert [axes.get_title("left") for axes in figure.axes] == [COVER, OTHER, "all environments"]
    marks = [line.get_xdata()[0] for line in figure.axes[1].get_lines() if line.get_marker() not in ("None", "")]
    assert marks == [-25.0, -5.0]
    assert [text.get_text() for text in figure.axes[0].get_yticklabels()] == ["ippo", "mappo"]


def test_one_environment_has_no_panel_for_all():
    """There is nothing to take together."""
    own = plan(seeds=1, algorithms=("ippo",))
    alone = Scores(own, {own.references[0].name: result(last=0.0), own.trainings[0].name: result(1.0, 2.0)})
    assert len(scores_figure(alone).axes) == len(curves_figure(alone).axes) == 1
    assert "All environments" not in page(alone, {**MADE, "command": "x"}, [])
