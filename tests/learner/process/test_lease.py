"""Of several coordinators one leads, and a silent one loses the lead for good."""

from eia_sec.common.imitation import LEASE_SECONDS
from eia_sec.learner.process.lease import Lease


def test_the_first_claimant_leads_until_it_is_silent():
    """The lead stays with whoever keeps claiming it, and goes to the next claimant after a silence."""
    lease = Lease()
    assert lease.claim("a", 1, 0.0)
    assert not lease.claim("b", 1, 1.0)
    assert lease.claim("a", 1, 2.0)
    assert not lease.claim("b", 1, 2.0 + LEASE_SECONDS - 0.01)
    assert lease.claim("b", 1, 2.0 + LEASE_SECONDS)
    assert not lease.claim("a", 1, 2.1 + LEASE_SECONDS)
    assert lease.holds("b", 1)
    assert not lease.holds("a", 1)


def test_another_start_of_the_same_name_is_another_coordinator():
    """A coordinator that was frozen and replaced under its own name holds nothing when it thaws."""
    lease = Lease()
    assert lease.claim("coordinator", 1, 0.0)
    assert lease.claim("coordinator", 2, LEASE_SECONDS)
    assert not lease.holds("coordinator", 1)
