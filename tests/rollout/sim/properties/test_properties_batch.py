"""Environments of a batch are independent, and only the configuration's numbers are drawn."""

import typing
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.config import FarmConfig
from eia_sec.common.transitions import EpisodeSummary
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.core.step import step_range
from tests.rollout.sim.course import STARTING, STEPPING, begin, fly
from tests.rollout.sim.properties.strategies import APART, Flight, dose, farm_configs, flights, switches, worlds

SHOWN = (*STARTING, *STEPPING, "time", "truncated")
Moment = tuple[dict[str, np.ndarray], EpisodeSummary]
Track = tuple[Flight, list[Moment]]
"""A flight and what its environment showed after the start and after every step."""


def moment(batch: FarmBatch, index: int) -> Moment:
    return {name: np.copy(getattr(batch, name)[index]) for name in SHOWN}, batch.summary(index)


def perform(programmes: list[list[Flight]], ticks: int) -> list[list[Track]]:
    """Fly one programme in each environment: whenever its episode is cut short, the next flight begins.

    Where one ends depends on its own seed alone, so resets fall between the steps of the others.
    """
    batch = FarmBatch(programmes[0][0].config, len(programmes))
    actions, ends = {}, {}
    tracks: list[list[Track]] = [[] for _ in programmes]
    for tick in range(ticks):
        row = np.empty((len(programmes), batch.team.environment_action_size), np.float32)
        for index, programme in enumerate(programmes):
            if tick == 0 or batch.time[index] == ends[index]:
                flight = programme[len(tracks[index]) % len(programme)]
                begin(flight, batch, index)
                actions[index] = flight.actions()
                ends[index] = 1 + flight.episode % flight.config.world.steps
                tracks[index].append((flight, [moment(batch, index)]))
            row[index] = actions[index][batch.time[index]]
        batch.step(row)
        for index, episodes in enumerate(tracks):
            episodes[-1][1].append(moment(batch, index))
    return tracks


def assert_same(ours: list[Track], theirs: list[Track]) -> None:
    assert len(ours) == len(theirs)
    for (_, left), (_, right) in zip(ours, theirs, strict=True):
        for (arrays, summary), (others, other) in zip(left, right, strict=True):
            assert summary == other
            for name, values in arrays.items():
                np.testing.assert_array_equal(values, others[name], err_msg=name)


@st.composite
def programmes(draw: st.DrawFn) -> list[list[Flight]]:
    """Draw up to five environments of one farm with up to three flights each; some fly the very same."""
    config = draw(farm_configs(worlds(st.integers(1, 8), 80)))
    distinct = draw(st.lists(st.lists(flights(st.just(config)), min_size=1, max_size=3), min_size=1, max_size=4))
    return [*distinct, distinct[0]] if draw(st.booleans()) else distinct


@dose(12)
@given(programmes(), st.randoms(use_true_random=False))
def test_a_batch_equals_its_environments_alone(company, random):
    """Bit by bit after every step: each episode in a batch of its own, and any part of the batch in any order."""
    together = perform(company, 25)
    for flight, track in random.choice(together):
        assert_same(perform([[flight]], len(track) - 1)[0], [(flight, track)])
    order = random.sample(range(len(company)), random.randint(1, len(company)))
    for index, episodes in zip(order, perform([company[index] for index in order], 25), strict=True):
        assert_same(episodes, together[index])


@dose(7)
@given(flights())
def test_the_same_seeds_fly_the_same(flight):
    """The same flight twice gives the same course, and no configuration triggers a new compilation."""
    first, again = fly(flight), fly(replace(flight))
    for name in (*STARTING, *STEPPING):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert first.summary == again.summary
    assert len(step_range.signatures) == 1


def literals_and_booleans() -> list[tuple[str, str, object]]:
    """Return every value of every switch of a farm."""
    return [
        (section, name, value)
        for section, kind in ((f.name, typing.get_type_hints(FarmConfig)[f.name]) for f in fields(FarmConfig))
        for name, hint in typing.get_type_hints(kind).items()
        for value in (typing.get_args(hint) if typing.get_origin(hint) is typing.Literal else (False, True))
        if (typing.get_origin(hint) is typing.Literal or hint is bool) and name not in APART
    ]


def test_every_value_of_every_switch_is_drawn():
    """At least one farm in forty holds it, so a switch that is added tomorrow is tested tomorrow.

    Usually one in eight does, but Hypothesis draws other farms when other modules are loaded.
    """
    drawn = []

    @dose(400)
    @given(farm_configs())
    def collect(config):
        drawn.append(config)

    collect()
    assert len(literals_and_booleans()) >= 26
    for section, name, value in literals_and_booleans():
        held = sum(getattr(getattr(config, section), name) == value for config in drawn)
        assert held >= len(drawn) / 40, f"{section}.{name} = {value!r} was drawn {held} times"


def test_the_drawn_flights_exercise_what_they_test():
    """Among the default dose are packets, images, caps, borders, risk, motivation, full relays and large fleets."""
    seen: dict[str, list[bool]] = {}

    @dose(120)
    @given(flights())
    def collect(flight):
        course, world = fly(flight), flight.config.world
        relay = flight.config.relay
        most = np.bincount(course.assignment[-1]).max()
        for name, happened in {
            "packets": course.served_sensors.any(),
            "images": course.utility[:, course.kinds == 1].any(),
            "AoI at its cap": (course.aoi == world.aoi_max).any(),
            "VDF at its cap": (course.vdf == world.vdf_max).any(),
            "borders": course.parts[:, :, 3].any(),
            "risk": course.parts[:, :, 2].any(),
            "motivation": course.parts[:, :, 6].any(),
            "full relays": most == relay.capacity_for(world) > 1,
            "large fleets": world.uavs > 30,
            "many sensors": world.sensors > 100,
        }.items():
            seen.setdefault(name, []).append(bool(happened))

    collect()
    shares = {name: np.mean(happened) for name, happened in seen.items()}
    assert min(shares.values()) > 0.05, shares


@pytest.mark.parametrize("section", ["world", "relay", "observation", "dynamics"])
def test_switches_are_found_by_their_annotations(section):
    """Every section that has switches shows them to the strategy."""
    assert switches(typing.get_type_hints(FarmConfig)[section])
