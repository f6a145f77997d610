"""The learner applies the events that its own configuration has, when they are due, and refuses all others."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.imitation import ImitationEvent, ImitationSchedule
from eia_sec.common.protocol.messages import Envelope, ImitationMessage, ReceiptMessage
from eia_sec.learner.process.imitation_server import ImitationServer
from eia_sec.learner.process.lease import Lease

CONFIG = preset("eia-sec")
SCHEDULE = ImitationSchedule.of(CONFIG)
DUE = SCHEDULE.due_episode(1)
EVENT = ImitationEvent(1, 3, DUE, SCHEDULE.rate(1), (0,), ((1.0,),), 10)


def receipt(event, schedule=SCHEDULE, episodes=DUE, epoch=5, name="coordinator", since=0):
    """Send one event to a learner; return its receipt, the server, and the events that were applied."""
    answers, applied, lease = [], [], Lease()
    lease.claim("coordinator", 1, 0.0)
    request = SimpleNamespace(
        payload=ImitationMessage.of(event, epoch).encode(),
        attachment=Envelope("elite", name, 1, 1).encode(),
        reply=answers.append,
    )
    trainer = SimpleNamespace(episodes=episodes, version=7, events=0, separate_since=since, imitate=lambda event: True)
    server = ImitationServer(SimpleNamespace(waiting=lambda: [request]), trainer, schedule, lease, 5, applied.append)
    server.answer()
    return ReceiptMessage.decode(answers[0]), server, applied


def test_a_due_event_is_applied():
    """With number, episode, rate and version as they should be; nothing is counted as refused."""
    answer, server, applied = receipt(EVENT)
    assert (answer.done, applied) == (True, [EVENT])
    assert (server.metrics(), server.alarms()) == ({"imitations_refused": 0}, [])


@pytest.mark.parametrize(
    ("event", "options", "said"),
    [
        (EVENT, {"episodes": 0}, f"falls due at episode {DUE}, not {DUE}; 0 are finished"),
        (replace(EVENT, episode=0), {}, f"falls due at episode {DUE}, not 0"),
        (replace(EVENT, rate=1.0), {}, "has the rate"),
        (replace(EVENT, rate=float("nan")), {}, ""),
        (replace(EVENT, event=2), {}, "event 2 cannot follow event 0"),
        (replace(EVENT, event=1026), {}, "event 1026 cannot follow event 0"),
        (replace(EVENT, event=2**40), {}, "cannot follow event 0"),
        (replace(EVENT, version=8), {}, "evaluated version 8, which does not exist"),
        (EVENT, {"schedule": ImitationSchedule(CONFIG.elite, enabled=False)}, "never falls due in this run"),
        (EVENT, {"schedule": ImitationSchedule(replace(CONFIG.elite, enabled=False))}, "never falls due in this run"),
        (EVENT, {"since": None}, "event 1 came while agents share their actors"),
        (EVENT, {"since": 5 * DUE}, f"event 1 falls due at episode {6 * DUE}, not {DUE}"),
        (EVENT, {"epoch": 4}, "another start of the learner"),
        (EVENT, {"name": "other"}, "another coordinator leads"),
    ],
)
def test_what_the_configuration_does_not_have_is_refused_counted_and_shown(event, options, said):
    """Whatever a coordinator claims, no actor changes, and the reason is in the receipt and in an alarm."""
    answer, server, applied = receipt(event, **options)
    assert (answer.done, applied) == (False, [])
    assert said in answer.reason
    assert server.metrics() == {"imitations_refused": 1}
    assert server.alarms() == [f"1 requests to imitate were refused; the last one: {answer.reason}"]
