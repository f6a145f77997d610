"""Sweep routes and plans among no-fly zones on any farm: against the reference, and what they never suggest."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from common.config import FarmConfig, ZoneConfig
from common.farm import COLLECTION, MONITORING, farm_environment
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights
from tests.rollout.sim.properties.test_properties_added import moves, with_plans_that_fit
from tests.rollout.sim.properties.test_properties_airspace import SMALL, polygons, started
from tests.rollout.sim.properties.test_properties_reference import flown_beside, reference_of


@st.composite
def led(draw: st.DrawFn, configs: st.SearchStrategy[FarmConfig]) -> FarmConfig:
    """Draw a farm with zones, and with sweep routes, plans or both."""
    config = draw(configs)
    zones = ZoneConfig(tuple(draw(st.lists(polygons(config.world), min_size=1, max_size=4))))
    route = draw(st.booleans())
    plan = draw(st.integers(0 if route else 1, 3))
    inset = draw(st.sampled_from([0.5, 0.36, 0.1]))
    return with_plans_that_fit(
        replace(
            config,
            zones=zones,
            control=replace(config.control, monitoring_inset=inset),
            observation=replace(
                config.observation, zones=True, route=route, plan=plan, plan_paths=draw(st.integers(9, 14))
            ),
        )
    )


FLIGHTS = flights(led(farm_configs(SMALL)))


@dose(25)
@given(FLIGHTS)
def test_routes_and_plans_among_zones_equal_the_reference(flight: Flight):
    """Every quantity after every step, within the bounds of the observation."""
    batch, _, positions = started(flight)
    reference = reference_of(flight, batch, positions)
    assert sum(1 for _ in flown_beside(flight, batch, reference)) == min(20, flight.config.world.steps)


@dose(25)
@given(FLIGHTS)
def test_no_suggested_move_is_refused(flight: Flight):
    """Neither the move along the route nor the first one of the best plan, wherever UAVs stand, if any is possible."""
    batch, spec = started(flight)[0], farm_environment(flight.config)
    random = np.random.default_rng(flight.episode)
    for _ in range(8):
        for group, rows in zip(spec.team.groups, batch.team.split_observations(batch.observation[0]), strict=True):
            names = spec.tensor_names[group.name].observation
            refused = rows[:, [k for k, name in enumerate(names) if name.startswith("refused_")]] > 0.0
            for word in ("route_", "plan_"):
                marks = rows[:, [k for k, name in enumerate(names) if name.startswith(word)][:9]]
                if group.name in (MONITORING, COLLECTION) and marks.any():
                    most = np.maximum(marks.max(axis=1, keepdims=True), 1e-9)
                    assert not (refused & (marks >= most))[~refused.all(axis=1)].any()
        if batch.ended[0]:
            break
        batch.step(moves(flight.config, batch, random)[None])
