"""When the learner's reports need its group."""

from unittest.mock import MagicMock

import pytest

from eia_sec.common.errors import GroupError
from eia_sec.learner.process.service import Learner


def reporting(state):
    """Return a learner in a state, whose followers are gone."""
    learner = Learner.__new__(Learner)
    for name in ("schedule", "storage", "membership", "reporter", "callbacks"):
        setattr(learner, f"_{name}", MagicMock())
    learner.receiver, learner._state, learner._group = MagicMock(), state, MagicMock()
    learner._group.order.side_effect = GroupError("gone")
    return learner


@pytest.mark.parametrize("state", ["finished", "draining"])
def test_a_run_that_is_over_needs_no_followers(state):
    """Its last report is written, whoever has gone while the final state was saved."""
    learner = reporting(state)
    learner._report()
    learner._reporter.report.assert_called_once_with(state)


def test_a_run_that_trains_notices_that_followers_are_gone():
    """Each report asks for them."""
    with pytest.raises(GroupError):
        reporting("training")._report()
