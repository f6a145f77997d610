"""The tables of what users and operators met, in docs/explanation/reliability.md and docs/reference/security.md.

    python -m research.pages.incidents      # count the tests' cases anew, then refresh the pages

The counts are those of a collection by pytest and lie in research/results/reliability/incidents.
"""

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Final, NamedTuple

from research.pages.blocks import read_json, table

RECORD: Final = Path("research/results/reliability/incidents/cases.json")
COLLECT: Final = ("-m", "pytest", "--collect-only", "-q", "-m", "", "-p", "no:cacheprovider")


class Incident(NamedTuple):
    """One class of incidents.

    Attributes:
        what: what was met.
        outcome: what happens.
        tests: the files of its tests, below tests/.
    """

    what: str
    outcome: str
    tests: tuple[str, ...]


RELIABILITY: Final = (
    Incident(
        "a run that would begin anew: the learner's host is changed, in a fleet file or in rendered units",
        "`up` refuses, `fleet move-learner` moves the run, a unit for another host only resumes",
        ("deploy/hosts/test_learner_move.py", "deploy/hosts/test_render.py"),
    ),
    Incident(
        "a standstill: numbers or chunks that the learner would refuse for ever, a worker that waits for ever",
        "the worker checks by the learner's rules and ends with a sentence; in simulated runs everybody ends",
        ("learner/intake/test_chunk_rules.py", "learner/intake/test_receiver.py", "simulation/test_simulation.py"),
    ),
    Incident(
        "processes left behind; steps lost at Ctrl-C; an environment that crashes, hangs or ends its process",
        "environments are closed on every way out; partial chunks are delivered, or named and counted as lost; hangs "
        "and exits are named, counted, and their worker replaced",
        ("system/test_environment_processes.py", "rollout/worker/test_ending.py", "rollout/worker/test_outages.py"),
    ),
    Incident(
        "code from outside that breaks a contract, raises, exits, or sets what belongs to the process",
        "one sentence or the user's own traceback, exit code 2, before any other process starts",
        ("rollout/envs/test_guard.py", "rollout/envs/test_pettingzoo.py"),
    ),
    Incident(
        "exit codes and signals: SIGTERM while options are read, closed or full output, Ctrl-C during imports",
        "the code is that of what happened; no traceback",
        ("deploy/test_exit_codes.py", "deploy/test_cli.py"),
    ),
    Incident(
        "a process killed for lack of memory, by code of others, or again and again",
        "the alarm names signal, kernel counters and memory, or the foreign exit code",
        ("deploy/local/test_supervisor.py",),
    ),
    Incident(
        "a diverging training, weights beyond all bounds, a changed environment at a resume",
        "the run stops once, names the newest finite checkpoint; forged or unfit ones are refused in a sentence",
        ("system/test_divergence.py", "learner/checkpoint/test_forged.py", "learner/checkpoint/test_resume.py"),
    ),
    Incident(
        "false and missing alarms, silent logs, a run that ends without an update",
        "each alarm is said once without a terminal; a claim that takes long does not make the lead flap; each process "
        "logs its lifecycle",
        (
            "deploy/monitor/test_new_alarms.py",
            "deploy/monitor/test_run_end.py",
            "elite/test_claims.py",
            "system/test_logs.py",
        ),
    ),
    Incident(
        "one slow worker that stalls others",
        "patience has a bound; the others are answered",
        ("learner/intake/test_iteration_room.py", "learner/intake/test_iterations.py"),
    ),
)
SECURITY: Final = (
    Incident(
        "with certificates, readers that come late see nothing",
        "whoever may read is heard of by every sender, whoever came first",
        ("security/test_late_readers.py", "security/test_matrix.py"),
    ),
    Incident(
        "a coordinator whose events come early, at another rate, or in a run without imitation",
        "refused, counted, alarmed; no actor changes",
        ("learner/process/test_imitation_server.py",),
    ),
    Incident(
        "browsers that take the watch page's seats",
        "every seat is free when its browser is gone",
        ("deploy/monitor/web/test_watch_web.py",),
    ),
    Incident(
        "somebody else's run directory or files: links, pipes, devices, marks, names, polygons that cross themselves",
        "refused in one sentence before anything is written",
        (
            "deploy/local/test_run_directory.py",
            "deploy/local/test_contained_files.py",
            "common/test_policy_file.py",
            "common/test_regular_files.py",
            "rollout/farm_files/test_files.py",
        ),
    ),
    Incident(
        "a fleet file with hostile words",
        "refused, or written as text; a fleet file is code, and the page says so",
        ("deploy/hosts/test_fleet_file.py",),
    ),
    Incident(
        "no room for connections or descriptors",
        "an alarm, also when none is left",
        ("security/test_admission.py",),
    ),
)


def incidents(rows: tuple[Incident, ...], root: Path) -> str:
    """Return the table of some classes, with the counts of the record."""
    cases = (read_json(root / RECORD) or {"cases": {}})["cases"]
    found = []
    for row in rows:
        count = sum(cases.get(test, 0) for test in row.tests)
        files = ", ".join(f"`{Path(test).name}`" for test in row.tests)
        found.append([row.what, row.outcome, f"{count:,}", files])
    return table(["met", "what happens", "cases of its tests", "in"], found)


def counted() -> dict[str, int]:
    """Return the cases of each test file, as pytest collects them."""
    names = sorted({test for row in (*RELIABILITY, *SECURITY) for test in row.tests})
    command = [sys.executable, *COLLECT, *(f"tests/{name}" for name in names)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = Counter(line.partition("::")[0].removeprefix("tests/") for line in done.stdout.splitlines() if "::" in line)
    return {name: found[name] for name in names}


def main() -> None:
    """Count and write the record."""
    command = f"python {' '.join(COLLECT[:5])} '' FILE"
    RECORD.parent.mkdir(parents=True, exist_ok=True)
    RECORD.write_text(json.dumps({"command": command, "cases": counted()}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
