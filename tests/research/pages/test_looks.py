"""One colour for one thing in all pictures of the laboratory, and lines and marks that tell series apart without it."""

import json
from itertools import combinations
from pathlib import Path

import pytest

from eia_sec.deploy.reports.plots import OTHER_COLOURS, look
from research import looks
from research.benchmarks import simulator_page
from research.benchmarks.distribution import report as distribution
from research.benchmarks.peers import learning, reach, report
from research.experiments import critic_forms, tasks

RESULTS = Path(__file__).parents[3] / "research" / "results"


def kept(name):
    """Return results that are committed."""
    return json.loads((RESULTS / name).read_text(encoding="utf-8"))


def pair(style):
    """Return what is left of a look without its colour."""
    return style["linestyle"], style["marker"]


def test_series_differ_without_their_colours():
    """No two of many series have the same line and mark, nor the same colour and line, even past the last colour."""
    styles = [look(index) for index in range(3 * len(OTHER_COLOURS))]
    assert len({pair(style) for style in styles}) == len({(s["color"], s["linestyle"]) for s in styles}) == len(styles)


def test_programs_and_algorithms_share_no_look():
    """Programs have colours of their own, but for ours, and no two the same line and mark."""
    names = list(looks.PROGRAM_COLOURS)
    programs = {name: looks.program_look(*name.split(", ")) for name in names}
    assert looks.algorithm_look("eia-sec") == programs["EIA-SEC"] == look(0)
    colours = [style["color"] for name, style in programs.items() if name != "EIA-SEC"]
    assert len({*colours, *OTHER_COLOURS}) == len(colours) + len(OTHER_COLOURS)
    assert all(pair(programs[a]) != pair(programs[b]) for a, b in combinations(names, 2))
    assert looks.program_look("AgileRL", "one after the other") == looks.program_look("AgileRL")


FIGURES = {
    "spread/results.json": lambda data: learning.picture(data["runs"]),
    "reach/results.json": reach.picture,
    "reach/longer/results.json": reach.picture,
    "distribution/results.json": distribution.picture,
    "simulator/simulator.json": lambda data: simulator_page.growth_figure(data["scaling"]),
    "tasks/simple_spread/results.json": lambda data: tasks.picture(tasks.TASKS[data["task"]], data["results"]),
    "tasks/half_cheetah/results.json": lambda data: tasks.picture(tasks.TASKS[data["task"]], data["results"]),
    "peers/peers.json": report.figure,
    "critic_forms/forms.json": lambda data: critic_forms.figure(data["results"]),
}


@pytest.mark.parametrize("name", FIGURES)
def test_series_of_a_picture_differ_without_their_colours(name):
    """A picture says what was measured, has labelled axes, and no panel holds two names with one line and mark."""
    drawn = FIGURES[name](kept(name))
    assert drawn.get_suptitle()
    assert any(axes.get_xlabel() for axes in drawn.axes)
    assert any(axes.get_ylabel() for axes in drawn.axes)
    for axes in drawn.axes:
        named = {}
        for line in axes.lines:
            hollow = line.get_markerfacecolor() == "white"
            style = (line._unscaled_dash_pattern, line.get_marker(), hollow)
            named.setdefault(line.get_label(), set()).add(str(style))
        styles = [style for held in named.values() for style in held]
        assert len(styles) == len(set(styles)), axes.get_title()


def test_a_picture_is_drawn_again_from_its_results(tmp_path):
    """Page and picture of the simulator are written from what was measured, which stays as it is."""
    simulator_page.show(kept("simulator/simulator.json"), tmp_path)
    assert (tmp_path / "README.md").read_text() == (RESULTS / "simulator/README.md").read_text()
    assert {path.name for path in tmp_path.iterdir()} == {"README.md", "growth.png"}
