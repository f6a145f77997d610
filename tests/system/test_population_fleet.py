"""A population as a fleet: two hosts with mutual TLS; every role is killed, a member joins and one leaves."""

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.monitor.audit import audit
from tests.system.fleet import until
from tests.system.hosts import OnHosts
from tests.system.test_population import configured

HOSTS = """
[router]
host = "one"
[population.member-0]
host = "one"
[population.member-1]
host = "two"
[hosts.one]
host = "local"
folder = "one"
workers = 1
[hosts.two]
host = "local"
folder = "two"
workers = 1
"""
LATE = '[population.member-2]\nhost = "two"\n'
SECONDS = 240.0


class PopulationFleet(OnHosts):
    """The fleet, its certificates issued ahead for a third member's worker."""

    def __init__(self, folder: Path) -> None:
        toml = configured(100_000, 0.001).replace("[population]\n", "[population]\nmembers = 3\n")
        network = f'[network]\nendpoint = "{free_endpoint()}"\nkeys = "keys"\n'.replace("tcp/", "tls/")
        super().__init__(folder, HOSTS, toml, network)
        self.edit('preset = "eia-sec"\n', "")
        self.eia_sec("fleet", "keys", str(self.file))

    def rounds(self, host: str, member: str) -> list[dict[str, Any]]:
        """Return the rounds that a member took part in."""
        path = self.folder / host / "run" / "members" / member / "metrics.jsonl"
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        records = [json.loads(line) for line in lines if line.endswith("}")]
        return [record for record in records if record["kind"] == "exploit"]

    def until_round_of(self, *members: str) -> None:
        """Wait until a new round has been held, with exactly these members."""
        before = max((event["round"] for event in self.rounds("one", "member-0")), default=0)
        named = {f"test-{member}" for member in members}

        def held() -> bool:
            later = [event for event in self.rounds("one", "member-0") if event["round"] > before]
            return any(set(event["scores"]) == named for event in later)

        until(held, f"a round of {', '.join(sorted(named))}", SECONDS)


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[PopulationFleet]:
    """The fleet, whose processes are gone when the test is over."""
    found = PopulationFleet(tmp_path)
    yield found
    found.close([tmp_path / "one", tmp_path / "two"])


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_a_population_on_two_hosts(fleet: PopulationFleet, tmp_path: Path) -> None:
    """Rounds go on after a kill of each role; a member joins and leaves; every member's account is exact."""
    file = str(fleet.file)
    assert "--run test-member-1 --connect tls/" in fleet.eia_sec("up", file)
    fleet.until_round_of("member-0", "member-1")
    before = fleet.pids()
    assert set(before) == {
        "router.main",
        "learner.member-0",
        "learner.member-1",
        "elite.coordinator",
        "rollout.one-0",
        "rollout.two-0",
    }
    for name in ("elite.coordinator", "rollout.two-0", "learner.member-1", "router.main"):
        os.kill(before[name], signal.SIGKILL)
    fleet.until_round_of("member-0", "member-1")

    fleet.edit("[hosts.one]", f"{LATE}[hosts.one]")
    fleet.edit('folder = "two"\nworkers = 1', 'folder = "two"\nworkers = 2')
    fleet.eia_sec("fleet", "keys", file)
    fleet.eia_sec("up", file)
    fleet.until_round_of("member-0", "member-1", "member-2")
    (first, *_) = fleet.rounds("two", "member-2")
    assert first["round"] > 1

    fleet.edit(LATE, "")
    fleet.edit("workers = 2", "workers = 1")
    fleet.eia_sec("up", file)
    until(lambda: "learner.member-2" not in fleet.pids(), "the end of a member", 60.0)
    fleet.until_round_of("member-0", "member-1")

    fleet.eia_sec("down", file)
    assert fleet.pids() == {}
    fleet.eia_sec("fleet", "collect", file, "--out", str(tmp_path / "collected"), code=None)
    for member in ("member-0", "member-1"):
        found = audit(tmp_path / "collected" / "members" / member)
        assert found.clean, found.to_dict()
        assert found.produced > 0
    assert audit(tmp_path / "two" / "run" / "members" / "member-2").clean
