"""Names that TensorBoard, trackers and callbacks show."""

from eia_sec.common.protocol.metrics import METRICS, scalars

VALUES = {
    "state": "training",
    "updates": 5,
    "steps_per_second": 9.0,
    "curves": {"reward": {"mean": 1.0, "scout": 2.0, "relay": 0.0}, "steps": 50, "aoi": 0.4, "infos": {"wins": 3}},
    "statistics": {"learning_rate": 1e-3, "actor_loss/scout": 0.1, "actor_gradient/scout": 7.0, "iterations": 4.0},
    "ledger": {"lost": 6},
    "ledgers": {"0": {"lost": 6}},
    "waits": {"data": 8.0},
    "queue": 2,
}


def test_scalars_have_names_that_people_know():
    """Those of CleanRL where it has one, the rest in a group of its own; counters of single workers are left out."""
    assert scalars(VALUES, ["scout", "relay"]) == {
        "charts/SPS": 9.0,
        "charts/episodic_return": 1.0,
        "charts/episodic_return_scout": 2.0,
        "charts/episodic_return_relay": 0.0,
        "charts/episodic_length": 50.0,
        "charts/aoi": 0.4,
        "charts/infos/wins": 3.0,
        "charts/learning_rate": 1e-3,
        "losses/policy_loss_scout": 0.1,
        "eia_sec/actor_gradient/scout": 7.0,
        "eia_sec/iterations": 4.0,
        "eia_sec/ledger/lost": 6.0,
        "eia_sec/waits/data": 8.0,
        "eia_sec/queue": 2.0,
    }


def test_one_type_of_agent_is_not_named():
    """Its losses have exactly the names that other libraries give them."""
    alone = scalars({"curves": {"reward": {"mean": 1.0, "agent": 1.0}}, "statistics": {"kl/agent": 0.1}}, ["agent"])
    assert alone == {"charts/episodic_return": 1.0, "losses/approx_kl": 0.1}


def test_an_evaluation_has_names_of_its_own():
    """Those of the final policy are in `eval`."""
    found = scalars({"evaluation": {"reward": 5.0, "types": {"a": 4.0, "b": 6.0}, "steps": 9, "aoi": 0.2}}, ["a", "b"])
    names = {"eval/mean_reward": 5.0, "eval/mean_reward_a": 4.0, "eval/mean_reward_b": 6.0}
    assert found == {**names, "eval/mean_ep_length": 9.0, "eval/aoi": 0.2}


def test_no_two_metrics_have_the_same_name():
    """A scalar is one metric's."""
    named = [metric.scalar for metric in METRICS["learner"] if metric.scalar]
    assert len(named) == len(set(named))
