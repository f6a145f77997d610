"""The numbers that readings section 2 gives to check by hand, on the reference and on the compiled functions."""

import numpy as np
import pytest

from eia_sec.common.config import EnergyConfig, FarmConfig, RadioConfig, WorldConfig
from eia_sec.rollout.sim.core.constants import constants
from eia_sec.rollout.sim.core.motion import flight_power as compiled_flight_power
from eia_sec.rollout.sim.core.radio import delivery, received_power
from eia_sec.rollout.sim.reference.farm import free_space_loss, noise_mw, packet_loss, received_mw, vegetation_loss
from eia_sec.rollout.sim.reference.power import flight_power, other_power
from tests.constants import with_constants


def numbers(config: FarmConfig):
    return constants(config)


def kernel_plr(radio: RadioConfig, distance: float) -> float:
    c = numbers(FarmConfig(radio=radio)).radio
    return 1.0 - delivery(c, received_power(c, distance**2))


@pytest.mark.parametrize(
    ("speed", "power", "tolerance"), [(0.0, 13.3, 0.05), (0.41, 1.60, 0.005), (10.0, 23.8, 0.05), (14.14, 36.1, 0.1)]
)
def test_flight_power_is_what_the_readings_say(speed, power, tolerance):
    """Hovering and forward power, in the reference and in the kernel."""
    assert flight_power(EnergyConfig(), speed) == pytest.approx(power, abs=tolerance)
    kernel = compiled_flight_power(numbers(FarmConfig()).flight, speed)
    assert kernel == pytest.approx(flight_power(EnergyConfig(), speed), rel=1e-12)


def test_powers_given_in_dbm_are_added_in_watts():
    """0.1 + 0.1 W of communication, 4 + 16 W of computation, 2.5 W camera, 10 W collection."""
    energy, payload = EnergyConfig(), numbers(FarmConfig()).fleet.payloads
    for kind, power in enumerate((20.2, 22.7, 30.2)):
        assert other_power(energy, kind) == pytest.approx(power, rel=1e-12)
        assert payload[kind] == pytest.approx(power, rel=1e-12)


def test_safety_distance_is_twice_the_largest_step():
    """d_safety is 28.28 m."""
    assert numbers(FarmConfig()).fleet.safety == pytest.approx(28.28, abs=0.005)


def test_losses_at_twenty_metres():
    """67.4 dB of free space and 26.0 dB of vegetation; noise is -100.85 dBm."""
    radio = RadioConfig()
    assert free_space_loss(radio, 20.0) == pytest.approx(67.4, abs=0.05)
    assert vegetation_loss(radio, 20.0) == pytest.approx(26.0, abs=0.05)
    assert 10.0 * np.log10(noise_mw(radio)) == pytest.approx(-100.85, abs=0.005)
    c = numbers(FarmConfig(radio=radio)).radio
    assert 10.0 * np.log10(received_power(c, 400.0)) == pytest.approx(10.0 - 67.4 - 26.0, abs=0.1)
    assert 10.0 * np.log10(c.noise) == pytest.approx(-100.85, abs=0.005)


@pytest.mark.parametrize(
    ("power_dbm", "distance", "plr", "tolerance"),
    [(0.0, 20.0, 0.27, 0.005), (10.0, 30.0, 0.0009, 5e-5), (10.0, 40.0, 0.92, 0.005)],
)
def test_packet_loss_is_what_the_readings_say(power_dbm, distance, plr, tolerance):
    """PLR over distance, in the reference and in the kernel."""
    radio = with_constants(RadioConfig(), sensor_power_dbm=power_dbm)
    reference = packet_loss(radio, received_mw(radio, distance) / noise_mw(radio))
    assert reference == pytest.approx(plr, abs=tolerance)
    assert kernel_plr(radio, distance) == pytest.approx(reference, abs=1e-12)


def test_reach_ends_where_packets_have_no_chance():
    """Just inside the reach a packet has more than the least chance, just outside less."""
    for radio in (RadioConfig(), with_constants(RadioConfig(), sensor_power_dbm=0.0)):
        config = FarmConfig(radio=radio)
        c, height = numbers(config).radio, config.world.height_collection
        assert height < c.reach < 100.0
        inside, outside = ((c.reach * scale) ** 2 + height**2 for scale in (0.999, 1.001))
        assert delivery(c, received_power(c, inside)) >= 1e-12
        assert delivery(c, received_power(c, outside)) == 0.0


def test_whole_numbers_in_a_configuration_become_the_kernels_floats():
    """An integer field size, speed or weight changes no type that the kernel is compiled for."""
    whole = numbers(FarmConfig(world=with_constants(WorldConfig(field_x=400, speed_x_max=10), height_monitoring=20)))
    for ours, usual in zip(whole, numbers(FarmConfig()), strict=True):
        for a, b in zip(ours, usual, strict=True):
            assert type(a) is type(b)
            assert getattr(a, "dtype", None) == getattr(b, "dtype", None)
