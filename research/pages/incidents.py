"""The tables of what users and operators met, in docs/explanation/reliability.md and docs/reference/security.md.

    python -m research.pages.incidents      # count the tests' cases anew, then refresh the pages

The counts are those of a collection by pytest and lie in research/results/reliability/incidents.
"""

import json
import subprocess
import sys
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
        tests: the files of its tests, below tests/; FILE::NAME are those whose name begins so.
    """

    what: str
    outcome: str
    tests: tuple[str, ...]


RELIABILITY: Final = (
    Incident(
        "The learner's host is changed, in a fleet file or in rendered units",
        "`up` refuses; `fleet move-learner` moves the run; a unit for another host only resumes",
        ("deploy/hosts/test_learner_move.py", "deploy/hosts/test_render.py::test_a_learner_that_moves_begins_nothing"),
    ),
    Incident(
        "Numbers or chunks that the learner would refuse for ever",
        "the worker checks by the learner's rules, and ends with agent, index, value, limit and remedy",
        (
            "learner/intake/test_chunk_rules.py",
            "system/test_other_environment.py::test_numbers_beyond_the_limit",
            "rollout/envs/test_guard.py::test_an_observation_that_is_too_large",
        ),
    ),
    Incident(
        "Processes, sockets and files of an environment that outlive its worker",
        "closed on every way out, evaluation included; what a killed worker's environments started is ended with it",
        (
            "system/test_environment_processes.py::test_nothing_is_left",
            "system/test_environment_processes.py::test_workers_that_crash",
            "system/test_environment_processes.py::test_an_evaluation",
            "rollout/envs/test_guard.py::test_environments_that_were_made",
            "rollout/envs/test_pettingzoo.py::test_environments_of_an_evaluation",
            "rollout/envs/test_pettingzoo.py::test_an_environment_that_is_not_taken",
        ),
    ),
    Incident(
        "Code from outside that breaks PettingZoo's contract, raises, or exits; a library that ends the process",
        "one sentence or the user's own traceback, exit code 2, before a run directory is made",
        (
            "rollout/envs/test_guard.py",
            "rollout/envs/test_pettingzoo.py",
            "system/test_other_environment.py::test_what_an_environment_does_wrong",
            "system/test_other_environment.py::test_a_library_that_ends",
        ),
    ),
    Incident(
        "SIGTERM while options are read, Ctrl-C while modules are imported, closed or full output",
        "the exit code is that of what happened; no traceback",
        ("deploy/test_exit_codes.py", "deploy/test_output.py"),
    ),
    Incident(
        "Another team, other networks or other settings at `--resume`; a run that should be lengthened",
        "refused in the first process, with what differs and what to do instead",
        (
            "deploy/test_cli.py::test_another_configuration",
            "deploy/test_cli.py::test_more_episodes",
            "deploy/test_cli.py::test_what_a_resumed_run",
            "deploy/local/test_run_directory.py::test_a_run_goes_on_only",
            "learner/checkpoint/test_resume.py::test_a_checkpoint_of_another",
        ),
    ),
    Incident(
        "Steps lost at Ctrl-C or in a drain",
        "partial chunks are delivered; what nobody can take is named and counted as lost",
        (
            "rollout/worker/test_ending.py",
            "system/test_environment_processes.py::test_ctrl_c",
            "learner/intake/test_chunk_rules.py::test_a_short_chunk",
            "system/test_processes.py::test_a_drain",
        ),
    ),
    Incident(
        "An environment that hangs in reset or step",
        "an alarm names worker, call and seconds; `--env.step-timeout` ends and replaces the worker, counted",
        ("rollout/worker/test_outages.py::test_a_call", "rollout/envs/test_guard.py::test_the_running_call"),
    ),
    Incident(
        "A simulator or robot that is away",
        "the episode ends and is counted; the worker tries again with growing pauses, for ever",
        (
            "rollout/worker/test_outages.py::test_an_outage",
            "rollout/worker/test_outages.py::test_pauses",
            "rollout/worker/test_outages.py::test_the_trial",
            "rollout/remote/test_lease.py::test_an_outage",
        ),
    ),
    Incident(
        "Runs that begin within one second",
        "each gets a folder of its own",
        ("deploy/local/test_run_directory.py::test_runs_that_begin",),
    ),
    Incident(
        "No home directory, a package that cannot be written",
        "machine code is kept in a temporary folder, and a line says so",
        ("common/test_compiled_code.py",),
    ),
    Incident(
        "Training that diverges, weights beyond all bounds, policies with NaN",
        "the run stops once and names the newest finite checkpoint; such files are refused",
        (
            "system/test_divergence.py",
            "learner/process/test_metrics_log.py::test_a_training_that_diverges",
            "learner/checkpoint/test_forged.py::test_weights_that_overflow",
            "learner/checkpoint/test_resume.py::test_a_number_that_is_not_finite",
            "common/test_policy_file.py::test_not_a_number",
        ),
    ),
    Incident(
        "False alarms: a lead that changes to and fro, workers that are held back, a run that is over",
        "a claim that takes long leaves the lead where it is; ordinary waits are no alarm",
        (
            "elite/test_claims.py",
            "deploy/monitor/test_run_end.py",
            "deploy/monitor/test_odd_metrics.py::test_workers_that_the_learner_holds_back",
        ),
    ),
    Incident(
        "Missing alarms: a view that begins after the learner died, a full /dev/shm, runs without a terminal",
        "each alarm is said once as a line; a session that cannot be opened says why",
        (
            "deploy/monitor/test_new_alarms.py",
            "deploy/monitor/test_odd_metrics.py::test_a_view_that_began",
            "common/transport/test_bus.py::test_why_a_session",
        ),
    ),
    Incident(
        "Silent logs",
        "each process logs a line for each thing that happens to it, as text or JSON",
        (
            "common/test_log.py",
            "system/test_train.py::test_interrupt_drains",
            "deploy/test_cli.py::test_the_log_format",
        ),
    ),
    Incident(
        "One slow worker that stalls others",
        "patience has a bound; the others are answered",
        ("learner/intake/test_iteration_room.py", "learner/intake/test_iterations.py"),
    ),
    Incident(
        "A run that ends without one update; `up` on a finished run",
        "said before it starts; nothing is started",
        (
            "deploy/test_train_command.py::test_a_run_that_cannot",
            "deploy/hosts/test_learner_move.py::test_up_on_a_finished",
            "deploy/hosts/test_keeper.py::test_a_run_that_came",
        ),
    ),
    Incident(
        "A process killed for lack of memory, ended by code of others, or dying again and again",
        "the alarm names signal, kernel counters and memory, or the foreign exit code; restarts have an end",
        (
            "deploy/local/test_supervisor.py",
            "deploy/local/test_memory_kills.py",
            "system/test_environment_processes.py::test_a_run_whose_workers",
        ),
    ),
    Incident(
        "Protocol under combined faults",
        "in each simulated run everybody ends, and audit and invariants hold",
        ("simulation/test_simulation.py",),
    ),
)
SECURITY: Final = (
    Incident(
        "With certificates, readers that come late see nothing",
        "whoever may read is heard of by every sender, whoever came first",
        ("security/test_late_readers.py", "security/test_matrix.py"),
    ),
    Incident(
        "A coordinator whose events come early, at another rate, or in a run without imitation",
        "refused, counted, alarmed; no actor changes",
        ("learner/process/test_imitation_server.py",),
    ),
    Incident(
        "Browsers that take the watch page's seats",
        "every seat is free when its browser is gone",
        ("deploy/monitor/web/test_watch_web.py",),
    ),
    Incident(
        "Somebody else's run directory, with links",
        "refused before anything is written",
        ("deploy/local/test_run_directory.py::test_a_run_directory_with_links", "deploy/local/test_contained_files.py"),
    ),
    Incident(
        "Pipes, devices and byte order marks as files; policies cut, forged or too large",
        "refused in one sentence before memory is allocated",
        ("common/test_policy_file.py", "common/test_regular_files.py", "learner/checkpoint/test_forged.py"),
    ),
    Incident(
        "Farm files: polygons that cross themselves, holes, any text",
        "a farm or one sentence with file and line",
        ("rollout/farm_files/test_files.py", "rollout/farm_files/test_zones.py", "rollout/farm_files/test_areas.py"),
    ),
    Incident(
        "A fleet file with hostile words",
        "refused, or written as text; a fleet file is code, and the page says so",
        ("deploy/hosts/test_fleet_file.py",),
    ),
    Incident(
        "No room for connections or descriptors",
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
        names = dict.fromkeys(Path(test.partition("::")[0]).name for test in row.tests)
        files = ", ".join(f"`{name}`" for name in names)
        found.append([row.what, row.outcome, f"{count:,}", files])
    return table(["met", "what happens", "cases of its tests", "in"], found)


def counted() -> dict[str, int]:
    """Return the cases of each entry's tests, as pytest collects them.

    Raises:
        ValueError: an entry names no test.
    """
    entries = sorted({test for row in (*RELIABILITY, *SECURITY) for test in row.tests})
    files = sorted({f"tests/{entry.partition('::')[0]}" for entry in entries})
    done = subprocess.run([sys.executable, *COLLECT, *files], capture_output=True, text=True, check=True)
    cases = [line.removeprefix("tests/") for line in done.stdout.splitlines() if "::" in line]
    found = {entry: sum(case.startswith(entry) for case in cases) for entry in entries}
    if empty := [entry for entry, count in found.items() if not count]:
        raise ValueError(f"no test is called {', '.join(empty)}")
    return found


def main() -> None:
    """Count and write the record."""
    command = f"python {' '.join(COLLECT[:5])} '' FILE"
    RECORD.parent.mkdir(parents=True, exist_ok=True)
    RECORD.write_text(json.dumps({"command": command, "cases": counted()}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
