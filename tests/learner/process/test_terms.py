"""What a learner asks its workers for depends on how many are there."""

from threading import Lock
from types import SimpleNamespace

import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.protocol import keys
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.learner.intake.iteration_room import IterationRoom, Terms
from eia_sec.learner.intake.limits import IntakeLimits
from eia_sec.learner.process.membership import Membership
from eia_sec.learner.process.service import Learner
from tests.system.fleet import until


@pytest.mark.parametrize(("workers", "steps"), [(1, 1000), (4, 500)])
def test_what_is_published_follows_from_the_workers_that_are_there(workers, steps):
    """Before any of them has delivered, each is asked for its share of the iteration; others do not count."""
    published: list[Terms] = []
    learner = Learner.__new__(Learner)
    learner._schedule = SimpleNamespace(progress_timer=SimpleNamespace(restart=lambda now: None))
    room = IterationRoom(IntakeLimits.of(preset("generic")), 1, Lock())
    room.open(0, 2000, updating=False)
    learner.receiver = SimpleNamespace(room=room)
    learner._publisher = SimpleNamespace(publish_progress=lambda state, terms, arguments: published.append(terms))
    learner._state, learner._commands = "training", SimpleNamespace(arguments="")
    with Bus.listen(free_endpoint(), "control") as bus:
        learner._membership = Membership(bus, "r")
        tokens = [bus.announce(keys.LIVE.key("r", role="rollout", name=str(index))) for index in range(workers)]
        tokens.append(bus.announce(keys.LIVE.key("r", role="elite", name="main")))

        def all_are_there() -> bool:
            learner._publish_progress()
            return len(learner._membership.living) == len(tokens)

        until(all_are_there, "every token")
    assert published[-1].asked_steps == steps
