"""When a training has reached what is wanted: the clock, the farm that all programs fly, and the page."""

import argparse
import itertools
import json

import numpy as np
import pytest

from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import EiaSecError
from eia_sec.rollout.sim.batch import FarmBatch
from research.benchmarks.peers import flights, reach
from research.benchmarks.peers.flights import Course, FarmOfChoices


def test_peers_fly_what_our_actors_fly():
    """The same options lead to the same course, with smaller rewards, as in one of our workers."""
    farm, ours = FarmOfChoices(0.1), FarmBatch(PRESETS[reach.PRESET].farm, 1)
    assert [farm.action_space(name).n for name in farm.possible_agents] == [25] * 4 + [9] * 8
    seen, _ = farm.reset(options={"farm": 3, "episode": 5})
    ours.reset(0, 3, 5)
    draw = np.random.default_rng(0)
    for _ in range(5):
        given = {name: draw.integers(farm.action_space(name).n) for name in farm.possible_agents}
        row = np.array([list(given.values())], np.float32)
        ours.step(ours.team.adapt(ours.observation, row))
        seen, rewards, *_ = farm.step(given)
        np.testing.assert_array_equal(np.concatenate(list(seen.values())), ours.observation[0])
        np.testing.assert_allclose(list(rewards.values()), 0.1 * ours.reward[0], rtol=1e-6)


def a_course(monkeypatch, rewards, **more):
    """Return a course whose looks take ten seconds each and see these rewards, and the clock."""
    clock = [1000.0]
    seen = iter(rewards)

    def look(policy, farms):
        clock[0] += 10.0
        return next(seen)

    monkeypatch.setattr(flights, "reward_of", look)
    monkeypatch.setattr(flights.time, "time", lambda: clock[0])
    options = {"began": 1000.0, "every": 5.0, "limit": 20.0, "reward": 900.0, "farms": [1000], **more}
    return Course(argparse.Namespace(**options)), clock


def test_looking_takes_no_time_of_the_training(monkeypatch):
    """The clock stands while a policy is looked at, and the first look that shows enough ends the training."""
    course, clock = a_course(monkeypatch, [100.0, 899.0, 901.0])
    ended = []
    for second in range(1, 30):
        clock[0] += 1.0
        ended.append(course.over(None, 8 * second, second))
        if ended[-1]:
            break
    assert ended == [False] * 14 + [True]
    assert [(p["seconds"], p["steps"], p["reward"]) for p in course.points] == [
        (5.0, 40, 100.0),
        (10.0, 80, 899.0),
        (15.0, 120, 901.0),
    ]


def test_a_training_that_learns_nothing_ends(monkeypatch):
    """At the limit there is a last look, whatever it shows."""
    course, clock = a_course(monkeypatch, [1.0] * 9, limit=12.0)
    while not course.over(None, 0, 0):
        clock[0] += 1.0
    assert [p["seconds"] for p in course.points] == [5.0, 10.0, 12.0]


def a_result():
    """Return a result in which one of AgileRL's two seeds reached half of the bar and BenchMARL's did not."""

    def run(software, seed, *points):
        return {
            "software": software,
            "seed": seed,
            "points": [{"seconds": s, "steps": 1, "reward": r} for s, r in points],
        }

    runs = [
        run("EIA-SEC", 0, (10.0, 5.0), (20.0, 550.0), (60.0, 800.0)),
        run("EIA-SEC", 1, (30.0, 551.0), (70.0, 560.0)),
        run("AgileRL IPPO", 0, (200.0, 10.0), (250.0, 510.0)),
        run("AgileRL IPPO", 1, (360.0, 300.0)),
        run("BenchMARL MAPPO", 0, (360.0, -5.0)),
    ]
    origin = {"command": "c", "commit": "d", "cores": 2, "bar": 1000.0, "seconds": 70.0, "limit": 360.0, "every": 15.0}
    return {**origin, "runs": runs}


def test_who_never_got_there_took_longer_than_it_was_given():
    """A seed that was ended counts with the time that it had; where ours did not get there nothing is divided."""
    found = {(row["software"], row["share"]): row for row in reach.summary(a_result())}
    assert found["EIA-SEC", 0.5] == {
        **{"software": "EIA-SEC", "share": 0.5, "seeds": 2, "reached": 2, "seconds": 25.0, "least": 20.0, "most": 30.0},
        "times": 1.0,
    }
    assert (found["AgileRL IPPO", 0.5]["reached"], found["AgileRL IPPO", 0.5]["seconds"]) == (1, 305.0)
    assert found["BenchMARL MAPPO", 0.5]["times"] == pytest.approx(14.4)
    assert (found["EIA-SEC", 0.75]["reached"], found["EIA-SEC", 0.75]["times"]) == (1, None)
    text = reach.page(a_result())
    assert "| 50% (500) | EIA-SEC | 2 of 2 | 25 (20 to 30) | 1.0 |" in text
    assert "| 50% (500) | AgileRL IPPO | 1 of 2 | > 305 (250 to 360) | > 12.2 |" in text
    assert "| 75% (750) | EIA-SEC | 1 of 2 | > 65 (60 to 70) | - |" in text
    assert "EIA-SEC 800, AgileRL IPPO 510, BenchMARL MAPPO -5." in text
    assert reach.steps_per_second(a_result()) == pytest.approx(
        {"EIA-SEC": 0.0155, "AgileRL IPPO": 0.0034, "BenchMARL MAPPO": 0.0028}, rel=0.02
    )
    # Ours and the bar stand in the panel of each algorithm.
    assert [len(axes.lines) for axes in reach.picture(a_result()).axes] == [5, 4]


def test_looks_at_a_peer_become_rarer(monkeypatch):
    """Each waits for a tenth more time at least, because looking at slow actors takes longer than training them."""
    course, clock = a_course(monkeypatch, [1.0] * 99, limit=200.0)
    while not course.over(None, 0, 0):
        clock[0] += 1.0
    at = [p["seconds"] for p in course.points]
    assert at[:10] == [5.0 * n for n in range(1, 11)]
    assert all(later - at >= 0.1 * at for at, later in itertools.pairwise(at[10:-1]))
    assert len(at) < 28


def test_a_seed_that_fails_leaves_those_before_it(monkeypatch, tmp_path):
    """Whole seeds are written as they end, all programs of a seed before the next one."""
    flown = []

    def train(software, seed):
        flown.append((software, seed))
        if flown[-1] == ("AgileRL IPPO", 1):
            raise EiaSecError("no more memory.")
        return {"points": [{"seconds": 1.0, "steps": 1, "reward": 2.0}]}

    monkeypatch.setattr(reach, "provide", lambda *_: None)
    monkeypatch.setattr(reach, "reward_of", lambda *_: 1.0)
    monkeypatch.setattr(reach, "run_ours", lambda seed, _: train(reach.OURS, seed))
    monkeypatch.setattr(reach, "run_peer", lambda program, seed, *_: train(program.name, seed))
    monkeypatch.setattr("sys.argv", ["reach", "--seeds", "3", "--write", str(tmp_path)])
    with pytest.raises(EiaSecError, match="no more memory"):
        reach.measure()
    first = [(reach.OURS, 0), ("AgileRL IPPO", 0), ("BenchMARL IPPO", 0), ("BenchMARL MAPPO", 0)]
    assert flown == [*first, (reach.OURS, 1), ("AgileRL IPPO", 1)]
    kept = json.loads((tmp_path / "results.json").read_text())["runs"]
    assert [(run["software"], run["seed"]) for run in kept] == first
    assert "1 of 1" in (tmp_path / "README.md").read_text()


def test_peers_use_our_settings():
    """What a peer trains with is our preset's, under the names that the scripts understand."""
    passed = reach.settings(PRESETS[reach.PRESET])
    words = [text for name, value in passed.items() for text in (f"--{name.replace('_', '-')}", str(value))]
    asked = {
        "algorithm": "ippo",
        "seed": 0,
        "began": 0,
        "limit": 1,
        "every": 1,
        "reward": 1,
        "farms": 1000,
        "threads": 2,
    }
    others = [text for name, value in asked.items() for text in (f"--{name}", str(value))]
    parsed = flights.farm_options("a peer").parse_args([*others, *words])
    assert (parsed.width, parsed.rate, parsed.discount, parsed.reward_scale) == (64, 1e-3, 0.99, 0.1)
    assert parsed.iteration == reach.PEER_SETTINGS["iteration"]
    assert all(program.name.endswith(f" {program.algorithm.upper()}") for program in reach.PEERS)
    assert {program.algorithm for program in reach.PEERS} == {"ippo", "mappo"}
