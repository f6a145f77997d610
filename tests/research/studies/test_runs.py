"""Runs of the studies, and whole studies, at a scale of seconds inside this process."""

import contextlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import ControlConfig, FarmConfig
from eia_sec.common.errors import SchemaError, SimulationError, UsageError
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import load_policy
from eia_sec.common.process import StopSignal
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.deploy.reports.intervals import interquartile_mean
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import ActorPolicy, policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from research.studies.analysis.claims import CLAIMS
from research.studies.bench import Bench
from research.studies.catalogue import STUDIES
from research.studies.estimate import Estimator
from research.studies.flights import heading_order, visited_share
from research.studies.jobs import POLICY_SUFFIX, Job, Records
from research.studies.methods import EIA_SEC, PEERS
from research.studies.pages.plots import RESULTS
from research.studies.pages.redraw import redraw, summed_anew
from research.studies.perform import DIVERGED, StoppedError, perform
from research.studies.reproduce import PAGE, Plan, announce, announce_all, carry_out
from research.studies.runner import Runner
from research.studies.scales import CHOICE_FARM, FIRST_FARM
from research.studies.timing import separate_actors
from tests.research.studies.tiny_study import TINY, run_here


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return Bench(TINY, Records(tmp_path_factory.mktemp("study") / "records"))


@pytest.fixture(scope="module")
def trained(bench):
    (job,) = bench.runs(EIA_SEC, 1)
    perform(job, bench.records, "python -m research.studies training")
    return job


def plan(bench, study, write, reports):
    return Plan(study, bench, write, 1, [study, "--scale", "smoke"], reports.append)


def test_a_run_is_that_of_one_process(bench, trained):
    """Actors, counters and evaluation are those of the trainer that the lockstep test holds the processes to."""
    alone = train_in_process(trained.config)
    actors, metadata = load_policy(bench.records.path(trained, POLICY_SUFFIX))
    assert actors.digest() == alone.actors().digest()
    assert metadata["job"] == trained.digest
    result = bench.records.result(trained)
    assert {name: result[name] for name in ("episodes", "updates", "events", "evaluation_steps")} == {
        "episodes": alone.episodes,
        "updates": alone.updates,
        "events": alone.events,
        "evaluation_steps": alone.evaluation_steps,
    }
    farms = range(FIRST_FARM, FIRST_FARM + TINY.farms)
    flown = evaluate(trained.config.farm, ActorPolicy(actors), farms, 1, name="")
    np.testing.assert_allclose(result["evaluation"]["reward"], [s.reward for s in flown.per_farm], atol=1e-4)
    np.testing.assert_allclose(
        result["evaluation"]["metrics"]["aoi"], [s.metrics["aoi"] for s in flown.per_farm], atol=1e-4
    )


def test_a_run_takes_no_more_than_its_budget(bench, trained):
    """Training and imitation together have flown what the scale allows, and nearly all of it."""
    result, steps = bench.records.result(trained), trained.config.farm.world.steps
    assert result["events"] > 0
    flown = (result["environment_steps"] + result["evaluation_steps"]) / steps
    assert TINY.episodes - trained.config.rollout.environments - trained.config.elite.farms < flown <= TINY.episodes


def test_a_curve_is_made_of_the_finished_episodes(bench, trained):
    """Its points count episodes up to the last, and the mean of all of them is that of the episodes."""
    seen = []
    train_in_process(trained.config, lambda trainer, chunk: seen.extend(chunk.episodes))
    result = bench.records.result(trained)
    curve = result["curve"]
    assert curve["episodes"][-1] == len(seen) == result["episodes"]
    shares = np.diff([0, *curve["episodes"]])
    assert len(shares) == TINY.points
    assert np.average(curve["reward"]["mean"], weights=shares) == pytest.approx(
        np.mean([e.reward for e in seen]), abs=1e-3
    )
    assert np.average(curve["vdf"], weights=shares) == pytest.approx(
        np.mean([e.metrics["vdf"] for e in seen]), abs=1e-3
    )
    types = [curve["reward"][name] for name in ("communication", "monitoring", "collection")]
    np.testing.assert_allclose(np.mean(types, axis=0), curve["reward"]["mean"], atol=1e-3)


def test_evaluations_on_the_way_are_on_farms_of_choice(bench, trained):
    """The last of them is the trained policy on these farms."""
    result = bench.records.result(trained)
    actors, _ = load_policy(bench.records.path(trained, POLICY_SUFFIX))
    farms = range(CHOICE_FARM, CHOICE_FARM + TINY.choice_farms)
    flown = evaluate(trained.config.farm, ActorPolicy(actors), farms, 1, name="").total
    assert len(result["checks"]) == TINY.evaluations
    assert result["checks"][-1]["reward"] == pytest.approx(flown.reward, abs=1e-3)
    assert result["checks"][-1]["episodes"] == result["episodes"]


def newest_actors(config):
    """Train alone until a loss is beyond the bound, or an actor's number is not finite; return the last finite ones."""
    found = [TeamActors.initial(farm_team(config.farm), config.algorithm.hidden, config.seed)]

    class EndedError(Exception):
        pass

    def watch(trainer, chunk):
        found.append(trainer.actors().noise_free())
        losses = [value for key, value in trainer.statistics().items() if key.startswith("critic_loss")]
        if chunk.episodes and not all(loss <= DIVERGED for loss in losses):
            raise EndedError

    with contextlib.suppress(EndedError, SchemaError):
        train_in_process(config, watch)
    return found[-1]


@pytest.mark.parametrize(("rate", "moved"), [(1e6, False), (1e-3, True)])
def test_a_run_that_diverges_is_cut_short_and_said_so(bench, rate, moved):
    """Its record is finite, its curve shorter, and its policy the newest whose numbers were."""
    (job,) = bench.runs(EIA_SEC, 1)
    wild = replace(job.config.algorithm, critic_rate=rate, reward_scale=1e4)
    job = replace(job, config=replace(job.config, algorithm=wild))
    perform(job, bench.records, "test")
    result = bench.records.result(job)
    assert result["diverged"] is True
    assert result["episodes"] < job.config.episodes
    actors, _ = load_policy(bench.records.path(job, POLICY_SUFFIX))
    assert actors.digest() == newest_actors(job.config).digest()
    assert (actors.digest() != TeamActors.initial(actors.team, actors.hidden, job.config.seed).digest()) is moved
    farms = range(FIRST_FARM, FIRST_FARM + TINY.farms)
    flown = evaluate(job.config.farm, ActorPolicy(actors), farms, 1, name="")
    np.testing.assert_allclose(result["evaluation"]["reward"], [s.reward for s in flown.per_farm], atol=1e-4)
    text = bench.records.path(job).read_text()
    assert "NaN" not in text
    assert "Infinity" not in text


def test_a_run_that_is_stopped_leaves_no_record(bench, tmp_path):
    """What ends it passes through, and the next start does all of it."""
    records = Records(tmp_path)
    (job,) = bench.runs(PEERS[0], 1)

    def stopping(share):
        if share > 0.4:
            raise StoppedError("enough")

    with pytest.raises(StoppedError):
        perform(job, records, "test", stopping)
    assert list(tmp_path.iterdir()) == []
    assert records.missing([job]) == [job]


def test_a_fault_of_the_run_is_no_divergence(bench, tmp_path):
    """Another error than numbers out of bounds passes through."""
    (job,) = bench.runs(EIA_SEC, 1)

    def failing(share):
        raise SimulationError("a defect")

    with pytest.raises(SimulationError, match="a defect"):
        perform(job, Records(tmp_path), "test", failing)


def test_a_reference_is_the_heuristics_evaluation(bench):
    """A flight's record is what `eia-sec evaluate` would say."""
    job = bench.reference("greedy")
    perform(job, bench.records, "test")
    flown = evaluate(job.config.farm, policy_of("greedy", job.config.farm), range(1000, 1003), 1, name="")
    np.testing.assert_allclose(bench.records.result(job)["reward"], [s.reward for s in flown.per_farm], atol=1e-4)


@pytest.mark.parametrize("shared", [False, True])
def test_timed_networks_choose_as_the_actors_do(shared):
    """Types that choose moves and headings, with a network for each agent or one for all."""
    batch = FarmBatch(FarmConfig(control=ControlConfig(communication="headings", monitoring="moves")), 1)
    actors = TeamActors.initial(batch.team, 16, 0, per_type=False, shared=shared)
    batch.reset(0, 1, 1)
    np.testing.assert_allclose(
        separate_actors(actors)(batch.observation), actors.environment_actions(batch.observation), atol=1e-6
    )


@pytest.mark.parametrize("method", [EIA_SEC, PEERS[2]], ids=lambda method: method.name)
def test_timed_networks_decide_what_the_actors_decide(method, bench):
    """One network after another gives the actions of the stacked actors, with either kind of last layer."""
    from eia_sec.learner.registry import OFF_POLICY  # noqa: PLC0415  (only here)

    job = bench.timing(method, 6)[0]
    batch = FarmBatch(job.config.farm, 1)
    head = OFF_POLICY[job.config.algorithm.name].head
    actors = TeamActors.initial(batch.team, 16, 0, per_type=False, head=head)
    batch.reset(0, 1, 1)
    np.testing.assert_allclose(
        separate_actors(actors)(batch.observation), actors.environment_actions(batch.observation), atol=1e-6
    )
    perform(job, bench.records, "test")
    assert all(bench.records.result(job)[piece]["median"] > 0.0 for piece in ("decide", "separate", "simulate"))


@pytest.mark.parametrize("study", STUDIES)
def test_a_study_from_start_to_end_and_once_more(study, bench, tmp_path, monkeypatch):
    """It says how long it takes, writes data, pictures and a page, and a second start does nothing again."""
    reports = []
    monkeypatch.setattr(Runner, "run", run_here)
    first = plan(bench, study, tmp_path, reports)
    assert announce(first) >= 0.0
    assert carry_out(first, StopSignal())
    assert re.search(r"about \d+ (s|min)", "\n".join(reports)) or "are there" in reports[0]
    folder = tmp_path / "smoke" / study
    data = json.loads((folder / RESULTS).read_text())
    assert data["study"] == study
    assert data["command"] == f"python -m research.studies {study} --scale smoke"
    page = (folder / PAGE).read_text()
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", page)
    assert pictures
    assert all((folder / name).stat().st_size > 5000 for name in pictures)
    assert "its numbers mean nothing" in page
    assert data["commit"] in page
    runs = [run for method in data.get("methods", {}).values() for run in method.get("runs", ())]
    assert {run["compared_value"] for run in runs} == ({"mixture"} if runs else set())
    before = {path: path.stat().st_mtime_ns for path in bench.records.folder.iterdir()}
    reports.clear()
    again = plan(bench, study, tmp_path, reports)
    assert announce(again) == 0.0
    assert "runs are there" in reports[0]
    assert carry_out(again, StopSignal())
    assert {path: path.stat().st_mtime_ns for path in bench.records.folder.iterdir()} == before
    assert json.loads((folder / RESULTS).read_text()) == data
    if study in CLAIMS:
        assert all(row.ours for row in CLAIMS[study](data)), "the claims can read the results"


@pytest.mark.parametrize("study", ["ensemble", "inference", "trajectories"])
def test_a_study_is_drawn_again_from_its_records(study, bench, tmp_path, monkeypatch):
    """The same data, pictures and page come of them without any run; without them the page comes of the results."""
    monkeypatch.setattr(Runner, "run", run_here)
    done = plan(bench, study, tmp_path, [])
    carry_out(done, StopSignal())
    folder = tmp_path / "smoke" / study
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    monkeypatch.setattr(Runner, "run", lambda *_: pytest.fail("a run was started"))
    for path in folder.iterdir():
        path.unlink()
    redraw(done)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == files
    reports = []
    alone = plan(Bench(TINY, Records(tmp_path / "empty")), study, tmp_path, reports)
    (folder / PAGE).write_bytes(b"an older page\n" + files[PAGE])
    redraw(alone)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == files
    assert "runs are missing; written again from" in reports[0]
    (folder / RESULTS).unlink()
    with pytest.raises(UsageError, match=r"runs are missing, and there is no .*results.json"):
        redraw(alone)


def test_times_are_summed_up_anew_from_the_seeds(bench, tmp_path, monkeypatch):
    """Results that hold another summary of the same times get today's."""
    monkeypatch.setattr(Runner, "run", run_here)
    carry_out(plan(bench, "inference", tmp_path, []), StopSignal())
    path = tmp_path / "smoke" / "inference" / RESULTS
    data = json.loads(path.read_text())
    older = json.loads(path.read_text())
    older["teams"]["6"] |= {"decide": 123.0, "q95": {}}
    older["methods"]["MASAC"] |= {"separate": 123.0}
    path.write_text(json.dumps(older))
    redraw(plan(Bench(TINY, Records(tmp_path / "empty")), "inference", tmp_path, []))
    assert json.loads(path.read_text()) == data
    (seed,) = data["teams"]["6"]["seeds"]
    assert data["teams"]["6"]["decide"] == seed["decide"]["median"]
    assert data["teams"]["6"]["q95"]["separate"] == seed["separate"]["q95"]


def test_policies_that_learn_nothing_are_summed_up_anew_from_their_records(bench, tmp_path, monkeypatch):
    """Older results get the methods' statistic over their own farms, and the scale's ends too; other jobs' do not."""
    monkeypatch.setattr(Runner, "run", run_here)
    carry_out(plan(bench, "ensemble", tmp_path, []), StopSignal())
    data = json.loads((tmp_path / "smoke" / "ensemble" / RESULTS).read_text())
    older = json.loads(json.dumps(data))
    for policy in older["references"]["policies"].values():
        policy["reward"] = policy.pop("mean_reward")
    for method in older["methods"].values():
        method["normalised"] = [0.0, 0.0, 0.0]
    foreign = json.loads(json.dumps(older))
    foreign["references"]["policies"]["greedy"]["job"] = "another"
    wide = json.loads(json.dumps(older))
    del wide["sizes"]["first_farm"]
    for results in (older, foreign, wide):
        summed_anew(results, bench)
    assert older["references"] == data["references"]
    for name, method in data["methods"].items():
        assert older["methods"][name]["normalised"] == pytest.approx(method["normalised"], abs=1e-3)
    assert "mean_reward" not in foreign["references"]["policies"]["greedy"]
    flown = bench.records.result(bench.reference("greedy"))["reward"]
    assert len(flown) == TINY.farms
    middle = interquartile_mean(np.array([flown]))
    assert wide["references"]["policies"]["greedy"]["reward"] == pytest.approx(middle, abs=1e-3)


def test_what_studies_share_is_counted_once(tmp_path):
    """Of two studies with the same runs, all take as long as one of them, and each alone is reported too."""
    reports = []
    fresh = Bench(TINY, Records(tmp_path / "records"))
    one = plan(fresh, "trajectories", tmp_path, reports)
    announce_all([one, replace(one, study="trajectories")])
    seconds = [line.partition("about ")[2].partition(",")[0] for line in reports if "about" in line]
    assert len(seconds) == 3
    assert len(set(seconds)) == 1
    assert reports[-1].startswith(f"all: {len(one.jobs())} runs, those that studies share counted once")
    reports.clear()
    announce_all([one])
    assert "all:" not in "".join(reports)


def test_only_what_another_configuration_made_is_done_again(bench, tmp_path, monkeypatch):
    """With other settings the methods' runs are missing, and with the same ones none is."""
    monkeypatch.setattr(Runner, "run", run_here)
    carry_out(plan(bench, "ensemble", tmp_path, []), StopSignal())
    changed = Bench(replace(TINY, settings=TINY.settings + "[exploration]\nnoise_std_start = 0.25\n"), bench.records)
    more = Bench(replace(TINY, members=(1, 2, 3)), bench.records)
    missing = {
        name: [job.label for job in bench.records.missing(jobs)]
        for name, jobs in {
            "same": [job for stage in STUDIES["ensemble"].stages(bench) for job in stage],
            "changed": [job for stage in STUDIES["ensemble"].stages(changed) for job in stage],
            "more": [job for stage in STUDIES["ensemble"].stages(more) for job in stage],
        }.items()
    }
    assert missing["same"] == []
    assert len(missing["changed"]) == 4  # two trials and two values of k_s; the heuristics do not learn
    assert missing["more"] == ["k_s = 3, seed 0"]


def test_estimates_follow_from_what_was_measured(bench, trained):
    """A run that is there determines how long another of the same kind takes; twice the episodes take twice as long."""
    estimator = Estimator(bench.records)
    estimator.learn([trained])
    took = bench.records.get(trained)["seconds"]
    twice = replace(trained, config=replace(trained.config, seed=5, episodes=2 * trained.config.episodes))
    once = replace(trained, config=replace(trained.config, seed=5))
    assert estimator.seconds(twice) - estimator.seconds(once) == pytest.approx(took, rel=0.01)


def test_a_busy_machine_does_not_count(bench, trained, tmp_path):
    """Of several runs alike the one that took least determines how long the next takes, in whatever order they come."""
    records, result = Records(tmp_path / "records"), bench.records.result(trained)
    runs = [replace(trained, config=replace(trained.config, seed=seed)) for seed in range(4)]
    for run, seconds in zip(runs, (90.0, 30.0, 60.0), strict=False):
        records.put(run, {"command": "python -m research.studies training", "commit": "abc"}, seconds, result)
        records.path(run, POLICY_SUFFIX).touch()
    estimator = Estimator(records)
    estimator.learn(runs)
    longer = replace(runs[3], config=replace(runs[3].config, episodes=2 * trained.config.episodes))
    assert estimator.seconds(longer) - estimator.seconds(runs[3]) == pytest.approx(30.0)


def test_paths_in_numbers():
    """A straight line has one heading and few cells; a path of all headings has no order."""
    line = np.stack([np.linspace(0.0, 400.0, 101), np.full(101, 20.0)], axis=1)
    angle = np.linspace(0.0, 2 * np.pi, 321)[:-1]
    circle = 200.0 + 100.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert heading_order(line) == 1.0
    assert heading_order(circle) < 0.01
    assert heading_order(np.full((5, 2), 7.0)) == 1.0
    assert visited_share(line[:, None], (400.0, 400.0)) == pytest.approx(0.1)


def test_jobs_of_a_study_are_found_in_files(bench, trained, tmp_path):
    """What the runner hands to a process is the job itself."""
    path = tmp_path / "one.job.json"
    path.write_text(trained.to_json())
    assert Job.from_file(path).digest == trained.digest
