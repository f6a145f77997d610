"""Nothing is unpickled in any process of a real run, killed and resumed learner, monitor and flight included."""

import signal
from pathlib import Path

from tests.faults.tools.harness import run
from tests.system.fleet import RUN, until


def test_no_process_of_a_run_unpickles_anything(tmp_path: Path) -> None:
    """Under the audit hook a learner, its successor, workers, coordinator, monitor, flight node stay silent."""
    with run(tmp_path) as fleet:
        fleet.module = "tests.security.audited"
        joining = ("--run", RUN, "--connect", str(fleet.endpoint))
        fleet.learner()
        fleet.worker("0")
        fleet.worker("1")
        fleet.coordinator()
        fleet.start("monitor", "monitor", *joining, "--json", "--patience", "60")
        until(lambda: fleet.records("imitation"), "an imitation event")
        until(lambda: list((tmp_path / "run" / "checkpoints").glob("*")), "a checkpoint")
        fleet.kill("learner")
        fleet.learner("--resume")
        fleet.until_more()
        fleet.start("fly", "fly", "--policy", "trained", *joining)
        fleet.start("simulator", "simulator", *joining, "--steps", "3")
        assert fleet.wait("simulator") == 0, fleet.log("simulator")
        for name in ("fly", "monitor"):
            fleet.running[name].send_signal(signal.SIGTERM)
            assert fleet.wait(name) == 0, fleet.log(name)
        names = ["learner", "rollout-0", "rollout-1", "elite", "monitor", "fly", "simulator"]
        fleet.end()
        fleet.audit()
        logs = {name: fleet.log(name) for name in names}
    assert {name: text for name, text in logs.items() if "UNPICKLED" in text} == {}
    assert all(logs[name] for name in ("monitor", "fly", "simulator"))
