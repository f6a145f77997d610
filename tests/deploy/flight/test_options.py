"""What a user may get wrong with `eia-sec fly` and `eia-sec bridge`: one sentence, before anything starts."""

import sys

import pytest

from eia_sec.common.errors import UsageError
from eia_sec.deploy.commands.policies import bridge, fly
from eia_sec.deploy.flight.mavlink import MavlinkAutopilot, MavlinkOptions
from eia_sec.deploy.flight.px4 import Px4Autopilot
from tests.deploy.flight.air import Air
from tests.deploy.flight.mavlink_autopilot import free_port

LAWNMOWER = ("--policy", "lawnmower")
BRIDGE = ("mavlink", "--vehicle", "uav-7=monitoring_0")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "nothing to fly"),
        (("--policy", "missing.safetensors"), "missing.safetensors"),
        ((*LAWNMOWER, "--origin", "51.0"), "LATITUDE,LONGITUDE"),
        ((*LAWNMOWER, "--origin", "7.0,251.0"), "no latitude and longitude"),
        ((*LAWNMOWER, "--vehicle", "uav-7"), "NAME=AGENT"),
        ((*LAWNMOWER, "--vehicle", "uav-7=monitoring_9"), "no agent 'monitoring_9'"),
        ((*LAWNMOWER, "--vehicle", "monitoring_1=monitoring_0"), "same vehicle"),
        ((*LAWNMOWER, "--only", "uav-7"), "--only names uav-7"),
        ((*LAWNMOWER, "--validity", "0.01"), "validity must be between 0.1 and 1"),
        ((*LAWNMOWER, "--validity", "1.5"), "validity must be between 0.1 and 1"),
        ((*LAWNMOWER, "--rate", "1.5"), "rate must be between 2"),
        ((*LAWNMOWER, "--max-age", "1.5"), "max_age must be between 0.01 and 1"),
        ((*LAWNMOWER, "--farm", "-1"), "farm must be"),
        ((*LAWNMOWER, "--listen", "tcp/127.0.0.1:1", "--connect", "tcp/127.0.0.1:1"), "not both"),
        ((*LAWNMOWER, "--record", "missing/flight.mcap"), "cannot be made"),
    ],
)
def test_a_flight_that_cannot_begin_is_refused(arguments, sentence, tmp_path, monkeypatch):
    """Policies, places, vehicles, times and files."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=sentence):
        fly.command(arguments)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "one of mavlink, px4"),
        (("px4",), "missing: --vehicle"),
        (
            ("px4", "--vehicle", "uav-7=monitoring_0", "--autopilot", "tcp/10.41.10.1:7447"),
            "pretend to be it.*--insecure",
        ),
        (("mavlink", "--vehicle", "uav-7"), "NAME=AGENT"),
        ((*BRIDGE, "--rate", "1.0"), "rate must be between 2"),
        ((*BRIDGE, "--system", "0"), "system must be"),
        ((*BRIDGE, "--fastest", "0", "10"), "fastest must be above 0"),
        ((*BRIDGE, "--heights", "20", "10"), "lowest height"),
        ((*BRIDGE, "--baud", "0"), "baud must be"),
        ((*BRIDGE, "--patience", "0.1", "--connect", "tcp/127.0.0.1:{port}"), "nobody|nothing|no listener|answers"),
    ],
)
def test_a_bridge_that_cannot_begin_is_refused(arguments, sentence):
    """Kind, vehicle, rate, system, speed and endpoint."""
    port = free_port()
    with pytest.raises(UsageError, match=sentence):
        bridge.command([word.format(port=port) for word in arguments])


@pytest.mark.parametrize(("package", "extra"), [("pymavlink", "mavlink"), ("mcap", "record"), ("rosbags", "px4")])
def test_a_missing_extra_is_named(package, extra, tmp_path, monkeypatch):
    """Without pymavlink, mcap or rosbags, the sentence says what to install."""
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    begin = {
        "pymavlink": lambda: MavlinkAutopilot(MavlinkOptions("udpin:127.0.0.1:0")),
        "mcap": lambda: fly.command((*LAWNMOWER, "--record", str(tmp_path / "a.mcap"))),
        "rosbags": lambda: Px4Autopilot(Air()),
    }
    with pytest.raises(UsageError, match=rf"pip install 'eia-sec\[{extra}\]'"):
        begin[package]()
