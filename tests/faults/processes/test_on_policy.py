"""Kill -9 in runs that learn on policy: every step is accounted for, and iterations go on where they were."""

from tests.faults.processes.test_kills import check_learner, check_workers
from tests.faults.tools.harness import run
from tests.system.fleet import on_policy, until

ENDLESS = on_policy("ippo").replace("episodes = 8", "episodes = 1000000")
"""A run on policy that ends only when it is asked to."""


def test_a_killed_worker_is_replaced(tmp_path):
    """Of two workers one is killed; the learner takes in chunks of its next start, and nothing is unexplained."""
    one_chunk = ENDLESS.replace("chunk_steps = 10", "chunk_steps = 10\nspool_chunks = 1")
    with run(tmp_path, one_chunk) as fleet:
        fleet.learner()
        for name in ("0", "1"):
            fleet.worker(name)
        for name in ("0", "1"):
            until(lambda name=name: fleet.taken(name), f"chunks of worker {name}", 240.0)
        start = fleet.newest_incarnation("0")
        fleet.kill("rollout-0")
        fleet.worker("0")
        until(lambda: fleet.newest_incarnation("0") > start, "chunks of the new worker")
        fleet.end()
        found, ledger = fleet.audit(), fleet.status()["ledger"]
        assert ledger["unexplained"] == 0
        check_workers(
            {
                "unexplained": len(found.unexplained),
                "doubled": len(found.doubled),
                "lost_chunks": found.chunks["lost"],
                "kills": 1,
            }
        )


def test_a_killed_learner_resumes_its_iterations(tmp_path):
    """The next learner continues with the checkpoint's iterations, and its ledger holds exactly what was lost."""
    with run(tmp_path, ENDLESS) as fleet:
        fleet.learner()
        fleet.worker()
        until(lambda: list((tmp_path / "run" / "checkpoints").glob("checkpoint-*")), "a checkpoint", 240.0)
        until(lambda: fleet.status().get("statistics", {}).get("iterations", 0) >= 4, "iterations")
        fleet.kill("learner")
        fleet.learner("--resume")
        before = fleet.status()["statistics"]["iterations"]
        fleet.until_more()
        until(lambda: fleet.status()["statistics"]["iterations"] > before + 4, "more iterations")
        fleet.end()
        found, status = fleet.audit(), fleet.status()
        assert status["updates"] >= 8 * (before + 4)
        check_learner(
            {
                "unexplained": len(found.unexplained) + status["ledger"]["unexplained"],
                "doubled": len(found.doubled),
                "ledger_lost": status["ledger"]["lost"],
                "lost_with_the_learner_steps": found.lost_with["learner"],
            }
        )


def test_a_drained_run_resumes(tmp_path):
    """A learner drained at any moment of an iteration leaves a checkpoint from which the next one goes on."""
    with run(tmp_path, ENDLESS) as fleet:
        for index in range(3):
            fleet.learner(*["--resume"] * (index > 0))
            fleet.worker(f"w{index}")
            until(lambda index=index: fleet.taken(f"w{index}") > 3, "chunks", 240.0)
            assert fleet.drain()
            assert fleet.wait("learner") == 0
            assert fleet.status()["ledger"]["unexplained"] == 0
            fleet.kill(f"rollout-w{index}")
