"""A whole way: a flight node, a bridge in a process of its own, and an autopilot at the end of its protocol."""

import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from eia_sec.common.config.files import to_toml
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.flight.vehicle import Pose, VehicleLink
from tests.deploy.flight.autopilot import FakeAutopilot
from tests.system.fleet import RUN, TINY, configured, until

SECONDS = 90.0
UAV, AGENT = "uav-7", "monitoring_0"


def start(*command: str, log: Path, **streams) -> subprocess.Popen[bytes]:
    """Start a command of ours."""
    with log.open("wb") as out:
        return subprocess.Popen(
            [sys.executable, "-m", "eia_sec.deploy.cli", *command], stdout=out, stderr=out, **streams
        )


def autopilot_of(kind: str, where: str, opened: ExitStack) -> FakeAutopilot:
    """Return what the bridge connects, with its own way to it."""
    if kind == "mavlink":
        from tests.deploy.flight.mavlink_autopilot import FakeMavlink  # noqa: PLC0415 - an extra that may be missing

        autopilot: FakeAutopilot = FakeMavlink(int(where.rpartition(":")[2]), time.monotonic)
    else:
        from tests.deploy.flight.px4_autopilot import FakePx4  # noqa: PLC0415 - as the other way is imported

        wire = opened.enter_context(Bus.connect(Endpoint.parse(where), "control", wait=SECONDS))
        autopilot = FakePx4(wire, time.monotonic)
    opened.callback(autopilot.close)
    autopilot.place[:2] = [50.0, 50.0]
    return autopilot


@pytest.mark.parametrize("end", ["node", "bridge"])
@pytest.mark.parametrize("kind", ["mavlink", "px4"])
def test_a_heuristic_flies_an_autopilot_and_whoever_dies_the_vehicle_stops(kind: str, end: str, tmp_path: Path) -> None:
    """It moves once the pilot has armed it and chosen Offboard; after kill -9 of either program it stands still."""
    pytest.importorskip({"mavlink": "pymavlink", "px4": "rosbags"}[kind])
    config, endpoint, other = configured(TINY), free_endpoint(), free_endpoint()
    where = str(other) if kind == "px4" else f"udpin:127.0.0.1:{other.port}"
    farm = tmp_path / "farm.toml"
    farm.write_text(to_toml(config), encoding="utf-8")
    names = [name for group in ("communication", "monitoring", "collection") for name in names_of(config.farm, group)]
    node = start(
        *("fly", "--policy", "lawnmower", "--config", str(farm), "--run", RUN, "--connect", str(endpoint)),
        *("--vehicle", f"{UAV}={AGENT}", "--patience", str(SECONDS)),
        log=tmp_path / "fly.log",
    )
    bridge = start(
        *("bridge", kind, "--vehicle", f"{UAV}={AGENT}", "--autopilot", where),
        *("--local", "0", "0", "--run", RUN, "--connect", str(endpoint), "--reports", "--patience", str(SECONDS)),
        log=tmp_path / "bridge.log",
        stdin=subprocess.PIPE,
    )
    try:
        with Bus.listen(endpoint, "control") as bus, ExitStack() as opened:
            autopilot = autopilot_of(kind, where, opened)
            others = [VehicleLink(bus, RUN, name, name, (10.0, 10.0)) for name in names if name != AGENT]

            def turn() -> bool:
                for number, link in enumerate(others):
                    link.setpoint()
                    link.publish(Pose((10.0 + 20.0 * number, 10.0), 20.0, (0.0, 0.0)))
                autopilot.turn()
                return True

            def speed() -> float:
                return max(map(abs, autopilot.velocity))

            until(lambda: turn() and autopilot.pilot_sets_mode("OFFBOARD"), "a stream of set-points")
            assert speed() == 0.0
            autopilot.armed = True
            until(lambda: turn() and speed() > 1.0, "flight")
            (node if end == "node" else bridge).kill()
            until(lambda: turn() and autopilot.mode == "LOITER" and speed() == 0.0, "standstill")
            assert autopilot.failsafes == 1
            assert autopilot.rejected == []
    except BaseException:
        sys.stderr.write((tmp_path / "fly.log").read_text() + (tmp_path / "bridge.log").read_text())
        raise
    finally:
        for process in (node, bridge):
            process.kill()
            process.wait(10.0)


def names_of(farm, group):
    """Return the names of a type's agents."""
    return [f"{group}_{number}" for number in range(getattr(farm.world, f"{group}_uavs"))]
