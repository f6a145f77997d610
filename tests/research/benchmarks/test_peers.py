"""The parts of the side-by-side benchmarks that measure nothing: catalogue, order, parsing, ratios, tables."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import EiaSecError
from eia_sec.common.farm import farm_team
from eia_sec.deploy.reports.provenance import command
from research.benchmarks.peers import __main__ as driver
from research.benchmarks.peers import clock, report, session, venvs
from research.benchmarks.peers.catalogue import OURS, PROGRAMS, ROOT, Program
from research.benchmarks.peers.learning import FURTHER, RATES, each_episode, tuned
from research.benchmarks.peers.session import Job, Plan, ProgramError, arguments, jobs, parse
from research.benchmarks.peers.spread import EPISODE_STEPS, curve
from research.benchmarks.peers.summary import merged, summarised

RECORDED = json.loads((Path(__file__).parent / "recorded_peers.json").read_text(encoding="utf-8"))
PLAN = Plan(threads=(1, 2), repeats=2, seconds=0.5, updates=6, widths=(64,), batches=(1, 32, 1024))
BY_NAME = {(program.subject, program.name): program for program in PROGRAMS}

each_peer = pytest.mark.parametrize("program", [p for p in PROGRAMS if p.environment != OURS], ids=lambda p: p.name)


def pins(program: Program) -> dict[str, str]:
    return dict(line.split("==") for line in program.requirements.read_text().splitlines())


@each_peer
def test_every_peer_has_its_script_and_pinned_requirements(program):
    """The script exists, and each of its requirements names exactly one version."""
    assert (ROOT / (program.module.replace(".", "/") + ".py")).is_file()
    lines = program.requirements.read_text().splitlines()
    assert lines
    assert [line for line in lines if not re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+", line)] == []


@each_peer
def test_peers_run_on_our_torch(program):
    """Where a peer needs torch, it gets the version that this project is tested with."""
    ours = re.search(r"^torch==(.+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE)[1]
    assert pins(program).get("torch", ours) == ours


def test_a_repeat_takes_programs_in_turn():
    """Within a number of threads every program runs once, VMAS also by processes, and mpe2 on one thread only."""
    simulators = tuple(program for program in PROGRAMS if program.subject == "simulator")
    order = [(job.program.name, job.threads, job.processes) for job in jobs(simulators, PLAN)]
    assert order == [
        ("EIA-SEC", 1, 1),
        ("VMAS", 1, 1),
        ("mpe2", 1, 1),
        ("EIA-SEC", 2, 1),
        ("VMAS", 2, 1),
        ("VMAS", 1, 2),
    ]


def test_peers_learn_teams_of_our_sizes():
    """A peer's learner gets the farm's groups, and its script reads them as they are."""
    command = arguments(Job(BY_NAME["learner", "AgileRL"], 2), PLAN)
    groups = clock.parse_groups(command[command.index("--groups") + 1 :])
    wanted = [(g.name, g.count, g.observation_size, g.action_size) for g in farm_team(preset("study").farm).groups]
    assert groups == wanted
    options = clock.learner_options("AgileRL").parse_args(command[2:])
    assert (options.threads, options.updates, options.widths, options.batch) == (2, 6, [64], 128)


@pytest.mark.parametrize("run", RECORDED["runs"], ids=lambda run: f"{run['subject']}-{run['name']}")
def test_recorded_output_is_read(run):
    """The last line counts, whatever libraries print before it, and names the software and its figure."""
    job = Job(BY_NAME[run["subject"], run["name"]], run["threads"])
    lines, _ = parse(job, "a warning\n{ no JSON\n" + run["output"])
    assert {line["software"] for line in lines} <= {run["name"], "NumPy reference"}
    measure = "env_steps_per_second" if run["subject"] == "simulator" else "ms"
    assert all(line[measure] > 0 and line["agents"] > 0 for line in lines)


def test_output_without_result_is_an_error():
    """A program whose last line is no JSON has failed."""
    with pytest.raises(ProgramError, match="run_vmas printed no result"):
        parse(Job(BY_NAME["simulator", "VMAS"], 1), '{"lines": []}\nTraceback')


def simulator_line(software: str, environments: int, rate: float, **other: int) -> dict:
    case = {"case": "x", "agents": 12, "threads": 1, "processes": 1, "environments": environments, **other}
    return {"software": software, "env_steps_per_second": rate, **case}


def learner_line(software: str, algorithm: str, ms: float, form: str = "", width: int = 64) -> dict:
    return {"software": software, "algorithm": algorithm, "form": form, "width": width, "threads": 1, "ms": ms}


def test_repeats_become_best_and_median():
    """Of rates the largest is best, of times the smallest; the median is the middle one."""
    rates = [simulator_line("VMAS", 32, value) for value in (10.0, 30.0, 11.0)]
    times = [{**learner_line("AgileRL", "MADDPG", value), "median_ms": 9 * value} for value in (5.0, 3.0, 4.5)]
    rate, time = merged([*rates, *times])
    assert (rate["best"], rate["median"], rate["repeats"]) == (30.0, 11.0, [10.0, 30.0, 11.0])
    assert (time["best"], time["median"], time["repeats"]) == (3.0, 4.5, [5.0, 3.0, 4.5])


def test_simulators_are_compared_at_their_best_batch_on_equal_cores():
    """Each side's best batch counts; two processes of one thread are as many cores as one process of two threads."""
    result = summarised(
        [
            simulator_line("EIA-SEC", 1, 100.0),
            simulator_line("EIA-SEC", 32, 200.0),
            simulator_line("VMAS", 1, 1.0),
            simulator_line("VMAS", 1024, 50.0),
            simulator_line("EIA-SEC", 32, 360.0, threads=2),
            simulator_line("VMAS", 1024, 30.0, threads=2),
            simulator_line("VMAS", 1024, 90.0, processes=2),
        ]
    )
    one, two = result["simulator_ratios"]
    assert (one["cores"], one["ratio"], one["our_environments"], one["peer_environments"]) == (1, 4.0, 32, 1024)
    assert (two["cores"], two["ratio"], two["peer_processes"]) == (2, 4.0, 2)


def test_learners_are_compared_at_equal_width_with_the_faster_form():
    """Ratios stay inside a width, and of a peer's forms the fastest counts."""
    result = summarised(
        [
            learner_line("EIA-SEC", "MADDPG", 2.0),
            learner_line("EIA-SEC", "MADDPG", 4.0, width=128),
            learner_line("BenchMARL", "MADDPG", 30.0, "groups"),
            learner_line("BenchMARL", "MADDPG", 10.0, "one group"),
        ]
    )
    (ratio,) = result["learner_ratios"]
    assert (ratio["width"], ratio["peer_form"], ratio["ratio"]) == (64, "one group", 5.0)


def test_a_peer_stands_against_the_same_work():
    """MADDPG is held against our MADDPG, however it is spelt, and against nothing else."""
    named = learner_line("EIA-SEC", "maddpg", 2.0)
    default = learner_line("EIA-SEC", "eia-sec", 3.0)
    peer = learner_line("BenchMARL", "MADDPG", 9.0)
    assert report.counterpart(peer, [default, named]) is named
    assert report.counterpart(peer, [default]) is None
    assert report.counterpart({**peer, "algorithm": "MASAC"}, [default, named]) is None
    assert report.counterpart({**peer, "width": 128}, [default, named]) is None


def test_repeats_of_ours_are_one_case():
    """The speed of a matrix product, which differs from repeat to repeat, does not distinguish two cases."""
    lines = [{**learner_line("EIA-SEC", "maddpg", ms), "gflops": 100.0 + ms, "limit_ms": ms / 2} for ms in (6.0, 7.0)]
    (case,) = merged(lines)
    assert (case["best"], case["limit_ms"], case["repeats"]) == (6.0, 3.0, [6.0, 7.0])


def test_an_environment_is_made_again_when_its_requirements_change(tmp_path, monkeypatch):
    """Nothing is installed where the mark names the present requirements; any other mark is stale."""
    program = BY_NAME["simulator", "mpe2"]
    installed = []
    monkeypatch.setattr(venvs.venv, "create", lambda place, **_: place.mkdir(parents=True, exist_ok=True))
    monkeypatch.setattr(
        venvs.subprocess,
        "run",
        lambda command, **_: installed.append(command) or type("Done", (), {"returncode": 0})(),
    )
    assert not venvs.ready(program, tmp_path)
    venvs.provide(program, tmp_path, "--index-url 'some where'")
    assert installed[0][-2:] == ["--index-url", "some where"]
    assert venvs.ready(program, tmp_path)
    venvs.provide(program, tmp_path)
    assert len(installed) == 1
    (tmp_path / "mpe2" / venvs.MARK).write_text(venvs.digest("mpe2==0"))
    assert not venvs.ready(program, tmp_path)


def test_an_installation_that_fails_leaves_no_mark(tmp_path, monkeypatch):
    """A failed installation is reported in one sentence and tried again next time."""
    program = BY_NAME["simulator", "mpe2"]
    monkeypatch.setattr(venvs.venv, "create", lambda place, **_: place.mkdir(parents=True, exist_ok=True))
    monkeypatch.setattr(venvs.subprocess, "run", lambda *_, **__: type("Done", (), {"returncode": 1})())
    with pytest.raises(EiaSecError, match="environment of mpe2 could not be made"):
        venvs.provide(program, tmp_path)
    assert not venvs.ready(program, tmp_path)


def test_one_failing_program_does_not_end_the_session(tmp_path, monkeypatch):
    """What the others measured is kept, and the failure is named."""

    def run(job, plan, folder):
        if job.program.name == "VMAS":
            raise ProgramError("VMAS fell over.")
        return [simulator_line(job.program.name, 1, 5.0)], {"mpe2": "1"}

    monkeypatch.setattr(driver, "run", run)
    programs = driver.chosen("simulator", None)
    result = driver.measure(programs, Plan((1,), 2, 1.0, 1, (64,), (1,)), tmp_path)
    assert result["failures"] == ["VMAS fell over."] * 2
    assert [(line["software"], line["repeats"]) for line in result["simulator"]] == [
        ("EIA-SEC", [5.0, 5.0]),
        ("mpe2", [5.0, 5.0]),
    ]


def test_a_program_that_fails_or_hangs_is_reported(tmp_path, monkeypatch):
    """An exit code other than 0 brings the last line of what was said, and a hanging program is ended."""
    script = tmp_path / "mpe2" / "bin" / "python"
    script.parent.mkdir(parents=True)
    script.write_text("#!/bin/sh\necho first >&2; echo last words >&2; exit 3\n")
    script.chmod(0o700)
    job = Job(BY_NAME["simulator", "mpe2"], 1)
    with pytest.raises(ProgramError, match="run_mpe2 failed with 1 threads: last words"):
        session.run(job, PLAN, tmp_path)
    script.write_text("#!/bin/sh\nexec sleep 60\n")
    monkeypatch.setattr(session, "LIMIT", 0.2)
    with pytest.raises(ProgramError, match="not done after"):
        session.run(job, PLAN, tmp_path)


def test_an_unknown_program_is_refused(monkeypatch, capsys):
    """A name that is not there ends with one sentence and exit code 2."""
    monkeypatch.setattr("sys.argv", ["peers", "simulator", "--only", "BenchMARL"])
    with pytest.raises(SystemExit) as ended:
        driver.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == "there is no program BenchMARL here; known are EIA-SEC, VMAS, mpe2.\n"


def test_the_reported_command_names_no_machine():
    """Folders of environments and pip's options are left out, and every other option stays."""
    asked = [
        "both",
        "--venvs",
        "some/where",
        "--pip-args=--index-url there",
        "--only",
        "mpe2",
        "--pip-args",
        "",
        "--json",
    ]
    assert (
        command("python -m research.benchmarks.peers", asked)
        == "python -m research.benchmarks.peers both --only mpe2 --json"
    )
    asked = ["links 50 m", "--keep", "some/where"]
    assert (
        command("python -m research.experiments.conditions", asked)
        == "python -m research.experiments.conditions 'links 50 m'"
    )


class Ticking:
    """A clock that stands still until it may go on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        monkeypatch.setattr(clock.time, "perf_counter", lambda: self.now)

    def go(self, seconds: float) -> None:
        self.now += seconds


def test_the_fastest_block_counts(monkeypatch):
    """The rate is that of the block that was disturbed least."""
    ticking, calls = Ticking(monkeypatch), iter(range(10**6))

    def step() -> None:
        ticking.go(0.01 if next(calls) < 40 else 0.02)

    assert clock.step_rate(step, 0.8) == pytest.approx(100.0)


def test_updates_are_timed_in_bursts(monkeypatch):
    """Every second update being dearer, a burst of two holds one of each; the first ten do not count."""
    ticking, calls = Ticking(monkeypatch), iter(range(10**6))

    def update() -> None:
        number = next(calls)
        ticking.go(9.0 if number < 10 else 0.003 if number % 2 else 0.001)

    assert clock.update_times(update, 8) == (pytest.approx(2.0), pytest.approx(2.0))
    assert clock.bursts_of([0.0, 1.0, 3.0, 6.0, 10.0, 11.0]) == [1500.0, 3500.0]


def test_a_curve_of_ours_counts_every_episode():
    """Records hold the mean of the episodes that ended together; the curve's last step is the run's."""
    records = [{"episodes": 8, "reward": {"mean": -3.0}}, {"episodes": 10, "reward": {"mean": -1.0}}]
    assert each_episode(records) == [-3.0] * 8 + [-1.0] * 2
    assert curve(each_episode(records))["environment_steps"][-1] == 10 * EPISODE_STEPS


@pytest.mark.parametrize(("best", "tried"), [(0.001, 3), (0.004, 5), (0.00025, 5), (1.0, 3 + FURTHER)])
def test_rates_go_on_at_an_end_that_is_the_best(best, tried):
    """The grid grows until the best rate lies inside it, or FURTHER rates were added."""
    asked = []

    def reward(rate):
        asked.append(rate)
        return -abs(np.log(rate / best))

    assert tuned(reward) == pytest.approx(min(best, max(RATES) * 2**FURTHER))
    assert len(asked) == len(set(asked)) == tried
