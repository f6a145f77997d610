"""One training of a benchmark, small, in this process."""

from dataclasses import replace

import pytest

from eia_sec.common.config.files import with_values
from eia_sec.common.errors import CancelledError
from eia_sec.common.policy_file import load_policy
from eia_sec.deploy.benchmark import measure as subject
from eia_sec.deploy.benchmark.measure import measure, measured
from eia_sec.deploy.benchmark.records import POLICY, Records
from eia_sec.deploy.benchmark.trainings import RANDOM, Measuring, Training
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.rollout.evaluation import evaluate_run
from eia_sec.rollout.heuristics.random import RandomPolicy
from eia_sec.rollout.policies import ActorPolicy, SampledPolicy
from tests.deploy.benchmark.examples import base

TRAINING = Training("ippo", base(), Measuring(points=2, scenarios=2))


def returns(policy, scenarios):
    found = evaluate_run(TRAINING.config, policy, scenarios, 1, name="")
    return [score.reward for score in found.per_farm]


@pytest.fixture(scope="module")
def course():
    """The actors after each chunk of the training, without any evaluation between."""
    found = []
    train_in_process(
        TRAINING.config, lambda trainer, chunk: found.append((trainer.environment_steps, trainer.actors()))
    )
    return found


def test_a_training_is_that_of_one_process(course, tmp_path):
    """Evaluations change nothing: points and end are those of the policies of an ordinary training."""
    records = Records(tmp_path)
    measured(TRAINING, records)
    found = records.get(TRAINING)
    along, last = TRAINING.measuring.along(TRAINING.config), TRAINING.measuring.final(TRAINING.config)
    assert [point.step_count for point in found.points] == [400, 800] == [course[1][0], course[3][0]]
    for point, (_, actors) in zip(found.points, (course[1], course[3]), strict=True):
        assert point.returns == pytest.approx(returns(ActorPolicy(actors.noise_free()), along), abs=1e-5)
    end = course[-1][1]
    assert found.final == pytest.approx(returns(ActorPolicy(end.noise_free()), last), abs=1e-5)
    assert found.sampled == pytest.approx(returns(SampledPolicy(end), last), abs=1e-5)
    best = max((0, 1), key=lambda at: (sum(found.points[at].returns), at))
    best_actors = (course[1], course[3])[best][1]
    assert found.absolute == pytest.approx(returns(ActorPolicy(best_actors.noise_free()), last), abs=1e-5)
    assert 0.0 < found.points[0].seconds < found.points[1].seconds
    actors, metadata = load_policy(records.path(TRAINING, POLICY))
    assert actors.digest() == end.digest()
    assert (metadata["algorithm"], metadata["training"]) == ("ippo", TRAINING.digest)


def test_what_is_there_is_not_done_again(tmp_path, monkeypatch):
    """A process that is started again leaves a record as it is."""
    reference = replace(TRAINING, algorithm=RANDOM)
    records = Records(tmp_path)
    measured(reference, records)
    assert records.get(reference).final == pytest.approx(
        returns(RandomPolicy(), TRAINING.measuring.final(TRAINING.config)), abs=1e-5
    )
    monkeypatch.setattr(subject, "measure", lambda *_: pytest.fail("it was done again"))
    measured(reference, records)


def test_a_training_that_is_stopped_leaves_nothing(tmp_path):
    """Whoever reports decides, and neither record nor policy is written."""

    def report(share):
        if share >= 0.5:
            raise CancelledError("enough")

    with pytest.raises(CancelledError):
        measure(TRAINING, report)
    assert list(tmp_path.iterdir()) == []


def test_steps_of_imitation_count():
    """An algorithm that evaluates its elites ends earlier, so that all take as many; what is reported only rises."""
    changes = {"elite.farms": 2, "elite.cycle": 2, "elite.cycle_growth": 1.0, "algorithm.shared_until": 0.0}
    config = with_values(base().with_algorithm("eia-ppo"), changes)
    own = 0

    def watch(trainer, chunk):
        nonlocal own
        own = trainer.environment_steps
        return trainer.environment_steps + trainer.evaluation_steps >= config.steps

    trainer = train_in_process(config, watch)
    assert trainer.evaluation_steps > 0
    shares = []
    found, _ = measure(Training("eia-ppo", config, TRAINING.measuring), shares.append)
    assert found.points[-1].step_count == own + trainer.evaluation_steps
    assert own < config.steps <= found.points[-1].step_count
    assert shares == sorted(shares)
    assert 0.9 < shares[-1] <= 1.0
