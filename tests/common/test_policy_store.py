"""A copy of the actors takes newer parameters only, and has every imitation event in it exactly once."""

import dataclasses

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors, imitate
from eia_sec.common.errors import ProtocolError, SchemaError, VersionError
from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.policy_store import PolicyStore
from eia_sec.common.protocol.messages import ParametersMessage
from eia_sec.common.team import GroupSpec, TeamSpec

TEAM = TeamSpec((GroupSpec("a", 3, 4, 2), GroupSpec("b", 2, 5, 1)))


def parameters(version: int, event: int = 0, epoch: int = 1, seed: int = 0) -> ParametersMessage:
    actors = TeamActors.initial(TEAM, 8, seed, per_type=False)
    return ParametersMessage(epoch, version, event, 100, 0.5, TEAM.digest, 8, actors.head, actors.flat)


def event(number: int, rate: float = 0.25) -> ImitationEvent:
    return ImitationEvent(number, 1, 10, rate, (1, 0), ((0.0, 1.0, 0.5), (1.0, 0.0)))


def test_newer_parameters_are_taken_and_older_ones_counted() -> None:
    """Versions only grow; an equal or older one changes nothing and is counted as ignored."""
    store = PolicyStore(TEAM)
    assert store.offer_parameters(parameters(5))
    assert not store.offer_parameters(parameters(5, seed=1))
    assert not store.offer_parameters(parameters(4, seed=1))
    assert (store.version, store.ignored) == (5, 2)
    assert store.actors is not None
    assert store.actors.digest() == TeamActors.initial(TEAM, 8, 0, per_type=False).digest()


def test_actors_with_memory_are_taken_as_such() -> None:
    """The message names their memory; one that does not, or names another, does not fit the numbers."""
    actors = TeamActors.initial(TEAM, 8, 0, memory="gru")
    message = dataclasses.replace(parameters(1), flat=actors.flat, memory="gru")
    store = PolicyStore(TEAM)
    assert store.offer_parameters(ParametersMessage.decode(message.encode()))
    assert store.actors is not None
    assert (store.actors.memory, store.actors.digest()) == ("gru", actors.digest())
    for memory in (None, "lstm", ""):
        with pytest.raises(SchemaError):
            PolicyStore(TEAM).offer_parameters(dataclasses.replace(message, memory=memory))


def test_a_lower_epoch_never_returns() -> None:
    """Parameters of a learner that has been replaced are not applied, however high their version."""
    store = PolicyStore(TEAM)
    store.offer_parameters(parameters(1, epoch=2))
    assert not store.offer_parameters(parameters(999, epoch=1))
    assert store.offer_parameters(parameters(1, epoch=3))


def test_an_event_is_applied_once() -> None:
    """The same event offered again changes nothing."""
    store = PolicyStore(TEAM)
    store.offer_parameters(parameters(1))
    assert store.offer_imitation(event(1), 1)
    assert store.actors is not None
    digest = store.actors.digest()
    assert not store.offer_imitation(event(1), 1)
    assert store.actors.digest() == digest
    assert store.event == 1


def test_an_event_follows_parameters_that_lack_it() -> None:
    """Parameters that were sent before the learner knew the event get it on arrival; those that hold it do not."""
    store = PolicyStore(TEAM)
    store.offer_parameters(parameters(1))
    store.offer_imitation(event(1), 1)
    store.offer_parameters(parameters(2, event=0, seed=3))
    wanted = TeamActors.initial(TEAM, 8, 3, per_type=False)
    for flat, elite in zip(wanted.flat, (1, 0), strict=True):
        imitate(flat, elite, 0.25)
    assert store.actors is not None
    assert store.actors.digest() == wanted.digest()
    store.offer_parameters(parameters(3, event=1, seed=4))
    assert store.actors.digest() == TeamActors.initial(TEAM, 8, 4, per_type=False).digest()


def test_an_event_of_another_epoch_waits_or_is_dropped() -> None:
    """An event of a learner that was replaced is ignored; one of a newer learner waits for its parameters."""
    store = PolicyStore(TEAM)
    store.offer_parameters(parameters(1, epoch=5))
    assert not store.offer_imitation(event(1), 4)
    assert not store.offer_imitation(event(1), 6)
    assert (store.event, store.ignored) == (0, 1)
    store.offer_parameters(parameters(1, epoch=6))
    assert store.event == 1


def test_imitation_is_the_papers_blend() -> None:
    """theta_i = (1 - vartheta) theta_i + vartheta theta_elite, and the elite stays as it is."""
    flat = np.array([[0.0, 4.0], [1.0, 2.0], [3.0, -2.0]], np.float32)
    imitate(flat, 1, 0.25)
    np.testing.assert_allclose(flat, [[0.25, 3.5], [1.0, 2.0], [2.5, -1.0]])


def test_agents_that_share_their_parameters_have_nobody_to_imitate() -> None:
    """An event counts and changes nothing, whichever agent of the type is the elite."""
    store = PolicyStore(TEAM)
    actors = TeamActors.initial(TEAM, 8, 0, shared=True)
    store.offer_parameters(dataclasses.replace(parameters(1), flat=actors.flat))
    assert store.offer_imitation(event(1), 1)
    assert store.event == 1
    assert store.actors is not None
    assert store.actors.digest() == actors.digest()


@pytest.mark.parametrize(
    "message",
    [
        dataclasses.replace(parameters(1), team="other"),
        dataclasses.replace(parameters(1), flat=parameters(1).flat[:1]),
        dataclasses.replace(parameters(1), hidden=9),
        dataclasses.replace(parameters(1), flat=tuple(flat * np.float32(np.nan) for flat in parameters(1).flat)),
    ],
)
def test_parameters_that_do_not_fit_are_refused(message: ParametersMessage) -> None:
    """Another team, another width, a missing type or a NaN leave the copy as it was."""
    store = PolicyStore(TEAM)
    with pytest.raises(ProtocolError):
        store.offer_parameters(message)
    assert store.actors is None


def test_events_that_do_not_fit_are_refused() -> None:
    """An elite beyond the type's agents is a SchemaError."""
    with pytest.raises(SchemaError):
        PolicyStore(TEAM).offer_imitation(dataclasses.replace(event(1), elites=(3, 0)), 1)


def test_another_team_is_a_version_error() -> None:
    """The error says that the layouts differ."""
    with pytest.raises(VersionError):
        PolicyStore(TEAM).offer_parameters(dataclasses.replace(parameters(1), team="0" * 16))
