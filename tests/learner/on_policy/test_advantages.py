"""Generalised advantage estimation, against trajectories worked out by hand (gamma and lambda are 1/2)."""

import numpy as np
import pytest

from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED
from eia_sec.learner.on_policy.advantages import advantages

STEP, END, CUT = TRANSITION, TRANSITION | TERMINATED, TRANSITION | TRUNCATED
UNUSED = 99.0
"""Reward in a row without a step, which must not count."""
THREE = ([1.0, 2.0, 4.0, UNUSED], [1.0, 0.0, 2.0, 8.0])
"""Rewards and values of three steps and the final observation.

Without the final value the deltas are 0, 3 and 4 - 2 = 2, with it the last is 4 + 8 / 2 - 2 = 6.
"""
ENDED = [0.875, 3.5, 2.0, 0.0]
CONTINUED = [1.125, 4.5, 6.0, 0.0]
TWO = ([1.0, UNUSED, 2.0, 4.0, UNUSED], [1.0, 8.0, 0.0, 2.0, 8.0])
"""A segment of one step and a segment of two."""

CASES = {
    "terminal": (*THREE, [STEP, STEP, END, 0], False, ENDED),
    "terminal where the time limit is, too": (*THREE, [STEP, STEP, END, 0], True, ENDED),
    "time limit bootstraps": (*THREE, [STEP, STEP, CUT, 0], False, CONTINUED),
    "time limit is terminal": (*THREE, [STEP, STEP, CUT, 0], True, ENDED),
    "cut at a chunk's end": (*THREE, [STEP, STEP, STEP, 0], False, CONTINUED),
    "cut at a chunk's end where the time limit is terminal": (*THREE, [STEP, STEP, STEP, 0], True, CONTINUED),
    "two segments": (*TWO, [END, 0, STEP, STEP, 0], False, [0.0, 0.0, 4.5, 6.0, 0.0]),
    "two segments, the first cut": (*TWO, [STEP, 0, STEP, END, 0], False, [4.0, 0.0, 3.5, 2.0, 0.0]),
}


@pytest.mark.parametrize("case", CASES)
def test_advantages_are_those_worked_out_by_hand(case):
    """Each row with a step has its advantage exactly, and the others have 0."""
    reward, value, flag, ends, wanted = CASES[case]
    columns = [np.array(numbers, np.float32)[:, None] for numbers in (reward, value)]
    found = advantages(*columns, np.array(flag, np.uint8), np.float32([0.5]), 0.5, time_limit_ends=ends)
    assert found.dtype == np.float32
    assert found[:, 0].tolist() == wanted


def test_each_agent_has_its_own_discount():
    """Of two agents with equal rewards, the one with discount 1 counts the rest of the return in full."""
    reward, value = (np.repeat(np.array(numbers, np.float32)[:, None], 2, axis=1) for numbers in THREE)
    flag = np.array([STEP, STEP, STEP, 0], np.uint8)
    found = advantages(reward, value, flag, np.float32([0.5, 1.0]), 0.5, time_limit_ends=False)
    assert found[:, 0].tolist() == CONTINUED
    assert found[:, 1].tolist() == [4.5, 9.0, 10.0, 0.0]


@pytest.mark.parametrize(("decay", "discount"), [(1.0, 0.9), (0.0, 0.9), (0.95, 1.0)])
def test_a_long_segment_follows_the_definition(decay, discount):
    """Over fifty random steps A_t is the sum of (gamma lambda)^k delta_(t+k); with lambda 1 the return less V."""
    draw = np.random.default_rng(3)
    reward, value = (draw.normal(size=(51, 2)).astype(np.float32) for _ in range(2))
    flag = np.full(51, STEP, np.uint8)
    flag[50] = 0
    found = advantages(reward, value, flag, np.full(2, discount, np.float32), decay, time_limit_ends=False)
    delta = reward[:-1] + discount * value[1:] - value[:-1]
    weights = (discount * decay) ** np.arange(50.0)
    wanted = np.stack([(weights[: 50 - t, None] * delta[t:]).sum(axis=0) for t in range(50)])
    np.testing.assert_allclose(found[:50], wanted, atol=1e-4)
    if decay == 1.0:
        powers = discount ** np.arange(50.0)
        returned = (powers[:, None] * reward[:50]).sum(axis=0) + discount**50 * value[50]
        np.testing.assert_allclose(found[0] + value[0], returned, atol=1e-4)
