"""When a run's training reward reached a goal."""

from experiments.seeds import reached


def record(episodes, time, mean):
    return {"kind": "episodes", "episodes": episodes, "time": time, "reward": {"mean": mean}}


RECORDS = [{"kind": "status"}, *(record(16 * (k + 1), 2.0 * k, 100.0 * k) for k in range(8))]


def test_the_mean_of_the_newest_64_episodes_counts():
    """Rewards 0, 100, 200, ... by 16 episodes: the mean of four of them reaches 350 at the sixth."""
    assert reached(RECORDS, 150.0) == 6.0
    assert reached(RECORDS, 350.0) == 10.0


def test_a_goal_that_is_never_reached():
    """The best mean of four is 550; a single lucky record before 64 episodes does not count either."""
    assert reached(RECORDS, 551.0) is None
    assert reached([record(16, 1.0, 900.0)], 500.0) is None
