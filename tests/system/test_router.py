"""Behind a router everything is as it is without one, and Zenoh's own router takes the same configuration."""

import datetime
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from eia_sec.common.protocol import keys
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.credentials import Identity
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.deploy.monitor.audit import audit
from eia_sec.deploy.security import authority
from tests.system.fleet import RUN, TINY, Processes, configured, until

PARAMETERS = keys.PARAMETERS.key(RUN)
LONG = TINY.replace("episodes = 8", "episodes = 1000000")
ZENOHD = """
import sys, threading, zenoh
session = zenoh.open(zenoh.Config.from_file(sys.argv[1]))
threading.Event().wait()
"""
"""What zenohd does with a configuration file, as far as it concerns us."""


class Routed(Processes):
    """Processes that meet at a router, with certificates when there is a folder of them."""

    keys: Path | None = None

    def tls(self, name: str) -> tuple[str, ...]:
        return () if self.keys is None else ("--tls", str(self.keys / name))

    def router(self) -> subprocess.Popen[bytes]:
        """Start the router."""
        return self.start("router", "router", "--listen", str(self.endpoint), *self.tls("router.main"))

    def learner(self, *extra: str) -> subprocess.Popen[bytes]:
        """Start the learner behind the router."""
        run_dir = ("--run-dir", str(self.directory / "run"), *self.wanted)
        where = ("--run", RUN, "--connect", str(self.endpoint), *self.tls("learner.learner"))
        return self.start("learner", "learner", *where, *run_dir, *extra)

    def worker(self, name: str = "0", *extra: str) -> subprocess.Popen[bytes]:
        """Start a worker with its certificate."""
        return super().worker(name, *self.tls(f"rollout.{name}"), *extra)

    def coordinator(self, name: str = "elite") -> subprocess.Popen[bytes]:
        """Start the coordinator with its certificate."""
        where = ("--run", RUN, "--connect", str(self.endpoint))
        return self.start(name, "elite", *where, *self.tls("elite.coordinator"))


@pytest.fixture
def routed(tmp_path: Path) -> Iterator[Routed]:
    """Processes behind a router."""
    fleet = Routed(tmp_path)
    yield fleet
    fleet.close()


@pytest.fixture(scope="module")
def issued(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The keys of a router and of everybody behind it."""
    folder = tmp_path_factory.mktemp("authority") / "keys"
    authority.create(folder)
    year = datetime.timedelta(days=365)
    for name in ("learner.learner", "router.main", "site.barn"):
        authority.issue(folder, Identity.parse(name), ["127.0.0.1"], year)
    for name in ("rollout.0", "elite.coordinator", "monitor.m", "vehicle.v"):
        authority.issue(folder, Identity.parse(name), [], year)
    return folder


def test_a_router_changes_nothing(routed: Routed, issued: Path) -> None:
    """Behind a router, with certificates, a lockstep run ends with the weights of a run inside one process."""
    routed.keys = issued
    for start in (routed.coordinator, routed.worker, routed.router):
        start()
    routed.learner("--lockstep")
    assert routed.wait("learner") == 0, routed.log("router") + routed.log("learner")
    (end,) = routed.records("end")
    assert end["digest"] == train_in_process(configured()).actors().digest()
    assert routed.wait("rollout-0") == routed.wait("elite") == 0
    assert audit(routed.directory / "run").clean
    routed.running["router"].terminate()
    assert routed.wait("router", 30.0) == 0
    assert "for 7 certificates" in routed.log("router")


def alive(capsys: pytest.CaptureFixture[str], routed: Routed, *arguments: str) -> tuple[int, str]:
    """Return exit code and sentence of `eia-sec alive`."""
    code = dispatch(["alive", *arguments, "--run", RUN, "--connect", str(routed.endpoint)])
    return code, capsys.readouterr().out


def test_a_killed_router_and_the_probe(routed: Routed, issued: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A killed and replaced router stops nobody; the probe says who is alive, and who is not to blame."""
    routed.keys = issued
    routed.config.write_text(LONG)
    worker, monitor = routed.tls("rollout.0"), routed.tls("monitor.m")
    code, said = alive(capsys, routed, "rollout", "0", *worker, "--patience", "0")
    assert (code, "nobody answers" in said) == (1, True)
    assert alive(capsys, routed, "rollout", "0", *worker, "--patience", "0", "--blame")[0] == 0
    assert alive(capsys, routed, "router", "main", *routed.tls("router.main"), "--patience", "0")[0] == 1
    routed.router()
    code, said = alive(capsys, routed, "rollout", "0", *worker, "--patience", "60", "--blame")
    assert (code, "none of run test is alive" in said) == (0, True)
    routed.learner()
    routed.worker()
    until(lambda: alive(capsys, routed, "rollout", "0", *worker)[0] == 0, "a token", 90.0)
    assert alive(capsys, routed, "rollout", "1", *monitor, "--blame")[0] == 1
    assert alive(capsys, routed, "router", "main", *routed.tls("router.main"))[0] == 0
    history = routed.directory / "run" / "history" / "learner.jsonl"
    taken = lambda: history.read_text().count('["accepted"') if history.exists() else 0  # noqa: E731  # used thrice
    until(taken, "chunks")
    routed.kill("router")
    routed.router()
    before = taken()
    until(lambda: taken() > before + 3, "chunks through the new router")
    for name in ("rollout-0", "learner"):
        routed.running[name].terminate()
        assert routed.wait(name, 60.0) == 0, routed.log(name)
    found = audit(routed.directory / "run")
    assert found.clean, found.to_dict()


@pytest.mark.parametrize("tls", [True, False], ids=["tls", "tcp"])
def test_a_site_with_a_router_of_its_own(routed: Routed, issued: Path, tls: bool) -> None:
    """Its workers train over two routers; either one, and the learner, may be killed and come back."""
    routed.keys = issued if tls else None
    routed.config.write_text(LONG)
    site = free_endpoint()
    beyond = ("router", "--listen", str(site), "--connect", str(routed.endpoint), *routed.tls("site.barn"))
    routed.start("site", *beyond)
    until(lambda: "no link to the main router" in routed.log("site"), "the complaint")
    routed.router()
    routed.coordinator()
    routed.learner()
    main, routed.endpoint = routed.endpoint, site
    routed.worker()
    routed.endpoint = main
    history = routed.directory / "run" / "history" / "learner.jsonl"
    taken = lambda: history.read_text().count('["accepted"') if history.exists() else 0  # noqa: E731  # used often
    until(taken, "chunks over two routers")

    def goes_on() -> None:
        before = taken()
        until(lambda: taken() > before + 3, "chunks afterwards")

    goes_on()
    routed.kill("site")
    routed.start("site", *beyond)
    goes_on()
    routed.kill("router")
    until(lambda: routed.log("site").count("no link") > 1, "the complaint")
    routed.router()
    goes_on()
    routed.kill("learner")
    routed.learner("--resume")
    goes_on()
    for name in ("rollout-0", "elite", "learner", "site", "router"):
        routed.running[name].terminate()
        assert routed.wait(name, 60.0) == 0, routed.log(name)
    found = audit(routed.directory / "run")
    assert found.clean, found.to_dict()


def test_a_site_speaks_for_workers_alone(routed: Routed, issued: Path) -> None:
    """Who holds its certificate speaks for every worker, and neither for a learner, an operator, nor a flight node.

    A main router's certificate gives nothing to who connects with it.
    """
    routed.keys = issued
    routed.router()
    names = ("monitor.m", "rollout.0", "site.barn", "learner.learner")

    def connected(name: str) -> Bus:
        return Bus.connect(Endpoint.parse(str(routed.endpoint), issued / name), "control", 60.0)

    with ExitStack() as held:
        monitor, worker, site, learner = (held.enter_context(connected(name)) for name in names)
        metrics, parameters = monitor.subscribe(keys.METRIC.pattern(RUN), 16), worker.subscribe_state(PARAMETERS)
        foreign, forged = site.publish(keys.METRIC.key(RUN, role="rollout", name="1")), site.publish_state(PARAMETERS)
        arrived = []

        def heard() -> bool:
            foreign.put(b"for a worker")
            forged.put(b"forged")
            arrived.extend(metrics.drain())
            return bool(arrived)

        until(heard, "a metric", 30.0)
        assert parameters.poll() is None
        true = learner.publish_state(PARAMETERS)
        true.put(b"true")
        assert until(parameters.poll, "parameters", 30.0).payload == b"true"
        drains, vehicle = learner.serve(keys.COMMAND.pattern(RUN), 4), held.enter_context(connected("vehicle.v"))
        assert site.ask(keys.COMMAND.key(RUN, verb="drain"), b"", 2.0) is None
        assert not list(drains.waiting())
        commanded = vehicle.subscribe(keys.SETPOINT.pattern(RUN, vehicle="v"), 4)
        routers = held.enter_context(connected("router.main"))
        for other in (site, routers):
            other.publish(keys.SETPOINT.key(RUN, vehicle="v")).put(b"fly")
            other.publish_state(PARAMETERS).put(b"forged")
        time.sleep(1.0)
        assert not list(commanded.drain())
        assert parameters.poll() is None
        stolen = site.serve(keys.TRANSITION.pattern(RUN), 4)
        assert worker.ask(keys.TRANSITION.key(RUN, worker="0"), b"", 2.0) is None
        assert not list(stolen.waiting())


def test_zenohs_router_takes_the_printed_configuration(
    issued: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file of --print-config opens a router that routes for members and denies what the access list does not name."""
    place = free_endpoint()
    listen = ["--listen", str(place), "--tls", str(issued / "router.main")]
    assert dispatch(["router", *listen, "--print-config"]) == 0
    (tmp_path / "router.json5").write_text(capsys.readouterr().out)
    process = subprocess.Popen([sys.executable, "-c", ZENOHD, str(tmp_path / "router.json5")])
    try:
        links = [Endpoint.parse(str(place), issued / name) for name in ("monitor.m", "rollout.0")]
        mine, foreign = (keys.METRIC.key(RUN, role="rollout", name=name) for name in ("0", "1"))
        with Bus.connect(links[0], "control", 30.0) as monitor, Bus.connect(links[1], "control", 30.0) as worker:
            metrics, tokens = monitor.subscribe(keys.METRIC.pattern(RUN), 16), monitor.watch(keys.LIVE.pattern(RUN), 16)
            token = worker.announce(keys.LIVE.key(RUN, role="rollout", name="0"))
            assert until(tokens.poll, "the token", 30.0).present
            got = []

            def arrived() -> bool:
                worker.publish(foreign).put(b"not mine")
                worker.publish(mine).put(b"mine")
                got.extend(sample.key for sample in metrics.drain())
                return bool(got)

            until(arrived, "a metric", 30.0)
            assert (set(got), token is None) == ({mine}, False)
        with Bus.connect(links[1], "bulk", 30.0) as bulk:
            assert bulk.ask(keys.TRANSITION.key(RUN, worker="0"), b"", 5.0) is None
    finally:
        process.kill()
        process.wait(10.0)
