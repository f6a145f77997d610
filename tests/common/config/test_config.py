"""The configuration dataclasses: documented fields, impossible values refused in one sentence."""

import dataclasses
import math

import pytest

from eia_sec.common.config import (
    ALGORITHM_CONFIGS,
    EiaSecConfig,
    EliteConfig,
    EvaluationConfig,
    ExplorationConfig,
    FarmConfig,
    ObservationConfig,
    RelayConfig,
    ReplayConfig,
    RewardConfig,
    RolloutConfig,
    RunConfig,
    WorldConfig,
)
from eia_sec.common.errors import ConfigError
from research.pages.configuration_tables import field_docs, sections

OTHERS = [kind() for kind in ALGORITHM_CONFIGS.values() if kind is not EiaSecConfig]
FOUND = [*(section for _, section in sections(RunConfig())), *OTHERS]
SECTIONS = [type(section) for section in FOUND if dataclasses.fields(section)]
NUMBERS = [
    (type(section), field.name, getattr(section, field.name))
    for section in FOUND
    for field in dataclasses.fields(section)
    if type(getattr(section, field.name)) in (int, float)
]


def refusal(build) -> str:
    """Return the message with which `build` is refused, once it is known to be one sentence."""
    with pytest.raises(ConfigError) as caught:
        build()
    message = str(caught.value)
    assert message.endswith(".")
    assert "\n" not in message
    assert message.count(". ") == 0
    return message


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_every_field_has_a_docstring(section):
    """Every field of every configuration dataclass has a docstring that ends a sentence."""
    docs = field_docs(section)
    for field in dataclasses.fields(section):
        if not dataclasses.is_dataclass(getattr(section(), field.name)):
            assert docs.get(field.name, "").endswith((".", ")")), f"{section.__name__}.{field.name}"


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_configuration_is_frozen(section):
    """No field can be assigned once a configuration exists."""
    config = section()
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(config, dataclasses.fields(section)[0].name, 1)


@pytest.mark.parametrize(("section", "name", "value"), NUMBERS, ids=lambda part: getattr(part, "__name__", str(part)))
def test_no_number_is_unchecked(section, name, value):
    """Every number refuses what no quantity can be: NaN and infinity, or minus a huge integer."""
    impossible = (math.nan, math.inf, -math.inf) if isinstance(value, float) else (-(10**400),)
    for number in impossible:
        assert name in refusal(lambda number=number: section(**{name: number})) or name.endswith("cycle")


IMPOSSIBLE = [
    (WorldConfig, {"communication_uavs": 0}, "communication_uavs"),
    (WorldConfig, {"monitoring_uavs": 65}, "monitoring_uavs"),
    (WorldConfig, {"sensors": 10_001}, "sensors"),
    (WorldConfig, {"field_x": 0.0}, "field_x"),
    (WorldConfig, {"steps": 0}, "steps"),
    (WorldConfig, {"sensor_cycles": ()}, "sensor_cycles"),
    (WorldConfig, {"sensor_cycles": (40, 0)}, "cycle"),
    (WorldConfig, {"step_seconds": 7.0}, "whole number of steps"),
    (WorldConfig, {"sites": ((1.0, 2.0),)}, "sites names 1 places, but sensors is 400"),
    (WorldConfig, {"sensors": 2, "sites": ((1.0, 2.0), (3.0,))}, r"sites[1] must be [x, y]"),
    (WorldConfig, {"sensors": 2, "sites": ((1.0, 2.0), (3.0, 4.0, 1.0))}, r"sites[1] must be [x, y]"),
    (WorldConfig, {"sensors": 1, "sites": ((1.0, 2.0, 3.0, 4.0),)}, r"sites[0] must be [x, y]"),
    (WorldConfig, {"sensors": 1, "sites": ((1.0, 400.5),)}, "sites[0] (1, 400.5) lies outside the field"),
    (WorldConfig, {"sensors": 1, "sites": ((-0.5, 4.0),)}, "sites[0] (-0.5, 4) lies outside the field"),
    (WorldConfig, {"sensors": 1, "sites": ((math.nan, 4.0),)}, "sites[0] (nan, 4) lies outside the field"),
    (WorldConfig, {"sensors": 1, "sites": ((1.0, 2.0, 3.0),)}, "sites[0] has type 3, but the types are 0 to 2"),
    (WorldConfig, {"sensors": 1, "sites": ((1.0, 2.0, 0.5),)}, "sites[0] has type 0.5"),
    (WorldConfig, {"sensors": 2, "sites": ((1.0, 2.0, 0.0), (1.0, 2.0, 1.0))}, "sites names one place twice"),
    (RelayConfig, {"capacity": -1}, "capacity"),
    (RewardConfig, {"relayed": math.inf}, "relayed"),
    (ObservationConfig, {"sensors": 0}, "sensors"),
    (FarmConfig, {"relay": RelayConfig(capacity=1)}, "cannot serve 8 UAVs"),
    (FarmConfig, {"world": WorldConfig(sensors=5)}, "observation.sensors"),
    (EiaSecConfig, {"batch": 0}, "batch"),
    (EiaSecConfig, {"discount": 1.01}, "discount"),
    (EiaSecConfig, {"critic_rate": 0.0}, "critic_rate"),
    (EiaSecConfig, {"ensemble_members": 0}, "ensemble_members"),
    (EliteConfig, {"rate": 2.0}, "rate"),
    (EliteConfig, {"cycle": 0}, "cycle"),
    (EliteConfig, {"cycle_growth": 0.5}, "cycle_growth"),
    (ReplayConfig, {"capacity": 10}, "capacity"),
    (ReplayConfig, {"updates_per_step": -1.0}, "updates_per_step"),
    (ReplayConfig, {"capacity": 256, "warmup_steps": 1_000_000}, "warmup_steps"),
    (ExplorationConfig, {"noise_std_start": -0.1}, "noise_std_start"),
    (RolloutConfig, {"environments": 0}, "environments"),
    (EvaluationConfig, {"farms": 0}, "farms"),
    (RunConfig, {"seed": -1}, "seed"),
    (RunConfig, {"episodes": 0}, "episodes"),
]


@pytest.mark.parametrize(("section", "values", "named"), IMPOSSIBLE, ids=[str(case[1])[:50] for case in IMPOSSIBLE])
def test_impossible_value_is_refused_in_one_sentence(section, values, named):
    """An impossible value is refused with one sentence that names it."""
    assert named in refusal(lambda: section(**values))


def test_evaluation_is_on_farms_that_training_never_sees():
    """Their seeds begin at 1000, or behind the training farms."""
    assert RunConfig().unseen(3) == range(1000, 1003)
    assert RunConfig(rollout=RolloutConfig(train_farms=2000)).unseen(2) == range(2000, 2002)


def test_relay_capacity_serves_everybody():
    """The relays' capacity is as printed, or else just enough for all served UAVs: 4 relays serve 8 with 2 each."""
    assert RelayConfig().capacity_for(WorldConfig()) == 2
    assert RelayConfig(capacity=5).capacity_for(WorldConfig()) == 5
    assert RelayConfig().capacity_for(WorldConfig(communication_uavs=3)) == 3


def test_safety_distance_is_two_diagonal_steps():
    """The safety distance is 2 sqrt(10^2 + 10^2) times 1 s, 28.28 m (W9), and follows the step's length."""
    assert WorldConfig().safety_distance == pytest.approx(28.28, abs=0.005)
    assert WorldConfig(step_seconds=0.5).safety_distance == pytest.approx(14.14, abs=0.005)


def test_exploration_falls_linearly_and_stays():
    """The exploration noise falls linearly from start to end over six tenths of the run and stays there."""
    noise = ExplorationConfig(noise_std_start=0.3, noise_std_end=0.1)
    assert [noise.noise_std(progress) for progress in (-1.0, 0.0, 0.3, 0.6, 1.0)] == pytest.approx(
        [0.3, 0.3, 0.2, 0.1, 0.1]
    )
