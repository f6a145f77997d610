"""An authority with a certificate for each role, made once for all tests of this folder."""

import datetime
from pathlib import Path

import pytest

from eia_sec.common.transport.credentials import Identity
from eia_sec.deploy.security import authority

YEAR = datetime.timedelta(days=365)
MEMBERS = (
    "rollout.a",
    "rollout.b",
    "elite.coordinator",
    "monitor.m",
    "watcher.w",
    "operator.o",
    "vehicle.uav",
    "vehicle.other",
    "environment.site",
)


def make_authority(folder: Path) -> Path:
    """Return the folder of an authority with listeners, the members, and a worker that is not let in."""
    authority.create(folder)
    for name in ("learner.learner", "router.main", "flight.main"):
        authority.issue(folder, Identity.parse(name), ["127.0.0.1", "localhost"], YEAR)
    for name in (*MEMBERS, "rollout.unlisted"):
        authority.issue(folder, Identity.parse(name), [], YEAR)
    authority.revoke(folder, Identity.parse("rollout.unlisted"))
    return folder


@pytest.fixture(scope="session")
def keys_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The authority that everybody trusts."""
    return make_authority(tmp_path_factory.mktemp("keys") / "keys")


@pytest.fixture(scope="session")
def other_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Another authority, with certificates of the same names."""
    return make_authority(tmp_path_factory.mktemp("other") / "keys")
