"""The presets: the paper's tables as printed, the study's, what trains best, a smoke run."""

from dataclasses import replace
from operator import attrgetter

import pytest

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import differences, digest, read_saved, to_toml, with_values
from eia_sec.common.config.presets import PRESETS, preset
from eia_sec.common.config.run import RolloutConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_team

PRINTED = {
    # Table 1, environmental parameters
    "farm.world.field_x": 400.0,
    "farm.world.field_y": 400.0,
    "farm.world.speed_x_max": 10.0,
    "farm.world.speed_y_max": 10.0,
    "farm.world.height_communication": 22.0,
    "farm.world.height_monitoring": 20.0,
    "farm.world.height_collection": 18.0,
    "farm.world.sensors": 400,
    "farm.world.plots_x": 20,
    "farm.world.plots_y": 20,
    "farm.world.aoi_max": 5,
    "farm.world.vdf_max": 5,
    "farm.world.sensor_cycles": (40, 50, 60),
    "farm.world.vdf_cycle": 30,
    "farm.world.step_seconds": 1.0,
    # Table 2, hyperparameters
    "farm.reward.positioning": 1.0,
    "farm.reward.energy": 0.005,
    "farm.reward.collision_risk": 5.0,
    "farm.reward.boundary": 10.0,
    "farm.reward.monitoring": 2.0,
    "farm.reward.monitoring_idle": 0.5,
    "farm.reward.monitoring_motivation": 0.2,
    "farm.reward.collection": 2.0,
    "farm.reward.collection_idle": 0.5,
    "farm.reward.collection_motivation": 0.2,
    "algorithm.discount": 0.99,
    "algorithm.target_rate": 0.005,
    "algorithm.actor_rate": 1e-4,
    "algorithm.critic_rate": 1e-5,
    "algorithm.batch": 128,
    "algorithm.ensemble_copy_rate": 0.1,
    "algorithm.mixture_epsilon": 0.1,
    "replay.capacity": 2**16,
    "episodes": 2000,
    "farm.world.steps": 500,
    "elite.rate": 0.1,
    "elite.cycle": 10,
    # The text and its algorithms
    "farm.world.communication_uavs": 4,
    "farm.world.monitoring_uavs": 4,
    "farm.world.collection_uavs": 4,
    "farm.observation.form": "printed",
    "algorithm.ensemble": True,
    "algorithm.ensemble_members": 2,
    "algorithm.ensemble_loss": "mixture",
    "algorithm.ensemble_gradient": True,
    "algorithm.bootstrap": "local",
    "algorithm.actor_objective": "local",
    "elite.enabled": True,
    "elite.rate_decay": 0.5,
    "elite.cycle_growth": 2.0,
    "elite.farms": 1,
    "replay.updates_per_step": 1.0,
    # Constants of Table 1, which no preset changes
    "farm.relay.weight_centroid": 0.5,
    "farm.relay.weight_farthest": 0.2,
    "farm.relay.weight_relays": 0.3,
    "farm.energy.mass": 0.2,
    "farm.energy.gravity": 9.8,
    "farm.energy.air_density": 1.225,
    "farm.energy.hover_speed": 0.1,
    "farm.energy.drag_coefficient": 0.5,
    "farm.energy.propellers": 4,
    "farm.energy.propeller_radius": 0.1,
    "farm.energy.efficiency": 0.8,
    "farm.energy.body_area": 0.01,
    "farm.energy.static_power": 4.0,
    "farm.energy.voltage": 5.0,
    "farm.energy.clock_hz": 200e6,
    "farm.energy.activity_factor": 0.5,
    "farm.energy.load_capacitance": 6.4e-9,
    "farm.energy.transmit_dbm": 20.0,
    "farm.energy.receive_dbm": 20.0,
    "farm.energy.camera_power": 2.5,
    "farm.energy.collection_dbm": 40.0,
    "farm.radio.boltzmann": 1.38e-23,
    "farm.radio.temperature_k": 298.0,
    "farm.radio.bandwidth_hz": 20e6,
    "farm.radio.carrier_mhz": 2800.0,
    "farm.radio.packet_bytes": 20,
    "farm.radio.vegetation_scale": 0.2,
    "farm.radio.vegetation_frequency_exponent": 0.5,
    "farm.radio.vegetation_distance_exponent": 0.3,
}


@pytest.mark.parametrize("key", PRINTED)
def test_paper_preset_is_as_printed(key):
    """The paper preset has the value that the paper prints."""
    assert attrgetter(key)(PRESETS["paper"]) == PRINTED[key]


def test_only_presets_name_types_of_the_farm():
    """The preset `instant` gives the farm's types their numbers; all else in it is a default of the dataclasses."""
    lines = differences(RunConfig(), PRESETS["instant"])
    maps = {line.split(":")[0].rpartition(".")[0] for line in lines}
    assert maps == {"algorithm.discounts", "algorithm.entropy_scales", "algorithm.hindsight"}
    assert all(line.partition(": ")[2].startswith("none -> ") for line in lines)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_names_types_that_there_are(name):
    """Another environment has other types, so there its maps are empty."""
    config = PRESETS[name]
    config.algorithm.require_types([group.name for group in farm_team(config.farm).groups])
    other = config.with_environment("mpe2:simple_spread_v3")
    other.algorithm.require_types([])
    assert with_values(config, {"env.name": "mpe2:simple_spread_v3"}) == other
    assert not any(line.startswith("algorithm") and "-> none" not in line for line in differences(config, other))


def test_study_preset_departs_from_eia_sec_where_it_says():
    """The study preset differs from `eia-sec` in what the page on the method names, and in nothing else."""
    assert differences(PRESETS["study"], PRESETS["eia-sec"]) == [
        "episodes: 1200 -> 400",
        "farm.observation.mirrored: false -> true",
        "algorithm.potential_discount: 0.0 -> 0.995",
        "replay.updates_per_step: 0.125 -> 0.5",
    ]


@pytest.mark.parametrize("name", PRESETS)
def test_a_saved_configuration_is_read_back(name):
    """What a run saved is read back equal; a file without the format is refused."""
    text = to_toml(PRESETS[name])
    assert read_saved(text) == PRESETS[name]
    with pytest.raises(ConfigError, match="a run's configuration names its format, and this one does not"):
        read_saved(text.split("\n", 1)[1])


@pytest.mark.parametrize("name", PRESETS)
def test_an_option_of_a_later_version_has_its_default(name):
    """A file without an option is read as one with its default, and both have one digest."""
    config = PRESETS[name]
    key = "train_farms = "
    usual = replace(config, rollout=replace(config.rollout, train_farms=RolloutConfig.train_farms))
    older = "\n".join(line for line in to_toml(config).splitlines() if not line.startswith(key))
    assert read_saved(older) == usual
    assert digest(read_saved(older)) == digest(usual)
    assert (digest(usual) == digest(config)) is (usual == config)


def test_quick_preset_exercises_everything():
    """The quick preset learns in many iterations and evaluates, in few episodes of the farm that `inertial` learns."""
    quick, usual = PRESETS["quick"], PRESETS["inertial"]
    iterations = quick.episodes * quick.farm.world.steps / quick.on_policy.iteration_steps
    assert 20 <= iterations <= 80
    assert quick.episodes <= usual.episodes / 5
    assert quick.farm == usual.farm
    assert quick.algorithm == usual.algorithm
    assert 0 < quick.evaluation.farms < usual.evaluation.farms


def test_preset_is_found_by_name():
    """A preset is found by its name, and a name that is none is refused with those that are."""
    assert preset("quick") is PRESETS["quick"]
    with pytest.raises(
        ConfigError,
        match=r"^there is no preset 'fast'\. "
        r"The presets are inertial, quick, instant, generic, long, connected, failing, uneven, battery, field, "
        r"eia-sec, study, paper, eia, sec, base\.$",
    ):
        preset("fast")
