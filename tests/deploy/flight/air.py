"""A bus inside one process, and a clock that tests set: vehicles and pilots without a network."""

from collections import defaultdict, deque

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol.messages import Envelope
from eia_sec.common.transport.bus import Sample
from eia_sec.deploy.flight.deciders import ActorDecider
from eia_sec.deploy.flight.farm_map import FarmMap, team_vehicles
from eia_sec.deploy.flight.pilot import Pilot, PilotOptions
from eia_sec.deploy.flight.poses import Field

NOW = 1_700_000_000.0


class Clock:
    """Seconds since 1970 that pass when a test says so."""

    def __init__(self, now=NOW):
        self.now = now

    def __call__(self):
        return self.now


class _Publisher:
    def __init__(self, air, key):
        self._air, self._key = air, key

    def put(self, payload, attachment=b""):
        for queue in self._air.queues[self._key]:
            queue.append(Sample(self._key, payload, attachment))


class _Subscription:
    def __init__(self, capacity):
        self.queue = deque(maxlen=capacity)

    def drain(self):
        while self.queue:
            yield self.queue.popleft()


class Air:
    """What links and tests publish and subscribe on."""

    def __init__(self):
        self.queues = defaultdict(list)

    def publish(self, key, encoding=""):
        return _Publisher(self, key)

    def subscribe(self, key, capacity):
        found = _Subscription(capacity)
        self.queues[key].append(found.queue)
        return found


def make_pilot(
    config: FarmConfig, decider, *, seed=1000, clock=None, names=None, only=(), origin=None, age=1.0, **options
) -> Pilot:
    """Return the pilot of a farm; a decider that is a team's actors is wrapped."""
    decider = decider if hasattr(decider, "decide") else ActorDecider(decider)
    vehicles = team_vehicles(config, names or {}, only)
    field = Field(config, origin, age)
    return Pilot(decider, FarmMap(config, seed), vehicles, field, PilotOptions(**options), clock or Clock(0.0))


def envelope(name, sequence, start=1) -> bytes:
    """Return a vehicle's envelope."""
    return Envelope("vehicle", name, start, sequence).encode()


def agents(config: FarmConfig) -> tuple[str, ...]:
    """Return the names of a farm's agents."""
    return farm_team(config).agent_names
