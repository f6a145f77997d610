"""The log says who joins and who leaves."""

from eia_sec.common.process import Presence
from eia_sec.common.protocol import keys
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.learner.process import membership
from eia_sec.learner.process.membership import Membership
from tests.system.fleet import until


def test_every_process_that_appears_or_vanishes_is_one_line(monkeypatch):
    """Who was there before is logged as well, nobody twice, and a run's end is summed up."""
    endpoint, lines = free_endpoint(), list[str]()
    monkeypatch.setattr(membership, "log", lines.append)
    monkeypatch.setattr(membership, "ENTRIES", 2)
    with Bus.listen(endpoint, "control") as bus:
        first = Bus.connect(endpoint, "control")
        here = Presence(first, "r", "rollout", "0", 1)
        members = Membership(bus, "r")
        until(lambda: members.update() or members.living == {("rollout", "0")}, "the first is seen")
        assert lines == ["rollout 0 joined."]
        first.close()
        del here
        until(lambda: members.update() or not members.living, "it is gone")
        assert lines[1:] == ["rollout 0 left."]
        with Bus.connect(endpoint, "control") as crowd:
            names = [str(index) for index in range(5)]
            tokens = [crowd.announce(keys.LIVE.key("r", role="rollout", name=name)) for name in names]
            until(lambda: members.update() or len(members.living) == len(tokens), "the crowd is seen")
        joined = [line for line in lines[2:] if line.endswith("joined.")]
        summed = [int(line.split()[0]) for line in lines[2:] if "more processes" in line]
        assert len(joined) + sum(summed) == 5
