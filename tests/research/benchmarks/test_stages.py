"""The simulator's step with a clock after every stage."""

import pytest

from research.benchmarks import stages


def test_every_part_of_a_step_is_a_stage():
    """Parts that all farms have are timed, and parts under a condition too; a tick's number fits its table."""
    source, names = stages.instrumented()
    assert {"fly", "assign_relays", "photograph", "send", "reward_step", "see_relays", "see_plots"} < set(names)
    assert {"start", "lose_uavs", "change_cycles", "prepare_views"} < set(names)
    assert source.count("_tick(-1)") == 1
    assert [source.count(f"_tick({number})") for number in range(len(names))] == [1] * len(names)
    assert len(names) <= stages.STAGES


def test_a_stage_that_is_gone_is_said(monkeypatch):
    """Timing would be wrong without a word."""
    monkeypatch.setattr(stages, "STAGED", ("_move", "_serve_tasks"))
    with pytest.raises(LookupError, match="no _serve_tasks"):
        stages.instrumented()
