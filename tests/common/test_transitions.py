"""Which flags are those of whole segments."""

import numpy as np
import pytest

from eia_sec.common.errors import SchemaError
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import Rows

TEAM = TeamSpec((GroupSpec("a", 1, 2, 1),))


def rows(flags: list[int]) -> Rows:
    """Return rows of zeros with these flags."""
    count = len(flags)
    shapes = ((count, 2), (count, 1), (count, 1))
    observation, action, reward = (np.zeros(shape, np.float32) for shape in shapes)
    return Rows(observation, action, reward, np.array(flags, np.uint8))


@pytest.mark.parametrize("flags", [[1, 0], [1, 1, 5, 0], [3, 0, 1, 1, 0], [5, 0, 3, 0]])
def test_whole_segments_are_lawful(flags: list[int]) -> None:
    """Steps, at most the last of which ends its episode, and one row behind them."""
    rows(flags).check(TEAM)
    assert rows(flags).steps == sum(flag & 1 for flag in flags)


@pytest.mark.parametrize(
    "flags", [[3, 1, 0], [5, 1, 1, 0], [2, 0], [7, 0], [4, 1, 0], [0, 0], [1, 1], [1, 0, 0], [0, 1, 0], [9, 0], [1, 2]]
)
def test_other_flags_are_refused(flags: list[int]) -> None:
    """An end in the middle, both ends at once, an end without a step, rows that belong to nothing."""
    with pytest.raises(SchemaError, match="whole segments"):
        rows(flags).check(TEAM)
