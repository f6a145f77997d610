"""Jobs, their records, and what is compared with what."""

import json
import tarfile
from dataclasses import replace
from pathlib import Path

import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EliteConfig
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import UsageError
from eia_sec.common.farm import farm_team
from eia_sec.common.imitation import ImitationSchedule
from eia_sec.common.policy_file import save_policy
from research.studies.analysis.summary import reference_summary
from research.studies.bench import Bench
from research.studies.catalogue import STUDIES
from research.studies.command import ReproduceArguments
from research.studies.jobs import POLICY_SUFFIX, Job, Records
from research.studies.methods import (
    ABLATIONS,
    CANDIDATES,
    EIA_SEC,
    ON_POLICY_PEERS,
    PEERS,
    configuration,
    training_episodes,
    with_uavs,
)
from research.studies.scales import CHOICE_FARM, FIRST_FARM, FIRST_REPORTED, FULL, SMOKE, TRIAL_SEED
from tests.research.studies.tiny_study import TIMES, TINY, flown, trained

MADE = {"command": "python -m research.studies training", "commit": "abc1234"}


@pytest.fixture
def bench(tmp_path):
    return Bench(TINY, Records(tmp_path / "records"))


def timing(bench):
    return bench.timing(EIA_SEC, 12)[0]


def test_a_job_is_named_by_what_decides_its_outcome(bench):
    """Another seed, setting or evaluation is another job; another label is not."""
    job = bench.runs(EIA_SEC, 1)[0]
    config = job.config
    others = [
        replace(job, config=replace(config, seed=7)),
        replace(job, config=replace(config, algorithm=replace(config.algorithm, discount=0.5))),
        replace(job, options={**job.options, "farms": [1000, 4]}),
        replace(job, kind="fly"),
    ]
    assert len({job.digest, *(other.digest for other in others)}) == 5
    assert replace(job, label="by another name").digest == job.digest


def test_a_job_survives_its_file(bench, tmp_path):
    """What a process reads is the job that was written, configuration and all."""
    job = bench.runs(PEERS[2], 1)[0]
    (tmp_path / "job.json").write_text(job.to_json())
    read = Job.from_file(tmp_path / "job.json")
    assert read == replace(job, options=dict(job.options))
    assert read.digest == job.digest


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"kind": "sow"}', '{"kind": "fly", "label": 1, "config": "episodes = 0"}']
)
def test_a_file_that_is_no_job_is_a_users_mistake(text, tmp_path):
    """Whatever is in it, there is one sentence."""
    (tmp_path / "job.json").write_text(text)
    with pytest.raises(UsageError, match="not a study's run"):
        Job.from_file(tmp_path / "job.json")


def test_a_record_is_found_again(bench):
    """A result comes back with its origin, and only the jobs without one are missing."""
    job = timing(bench)
    other = replace(job, config=replace(job.config, seed=9))
    bench.records.put(job, MADE, 1.5, TIMES)
    assert bench.records.result(job) == TIMES
    record = bench.records.get(job)
    assert {**MADE, "seed": 0}.items() <= record.items()
    assert bench.records.missing([job, other, other]) == [other]
    assert [path.name for path in bench.records.folder.iterdir()] == [job.digest + ".json"]


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[: len(text) // 2],
        lambda text: text.replace('"format": 1', '"format": 0'),
        lambda text: text.replace('"seed": 0', '"seed": "0"'),
        lambda text: json.dumps([text]),
        lambda text: text.replace('"job": "', '"job": "f'),
        lambda text: "\x00" + text,
    ],
    ids=["cut", "older format", "wrong type", "list", "another job's", "noise"],
)
def test_a_damaged_record_counts_as_missing(damage, bench):
    """Nothing is read out of a record that is not whole, and nothing fails."""
    job = timing(bench)
    bench.records.put(job, MADE, 1.0, TIMES)
    path = bench.records.path(job)
    path.write_text(damage(path.read_text()))
    assert bench.records.missing([job]) == [job]


def changed(part, value):
    """Return a change of one part, a path of keys, of a result."""

    def change(result):
        *way, last = part
        for key in way:
            result = result[key]
        if value is None:
            del result[last]
        else:
            result[last] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        changed(["diverged"], 0),
        changed(["updates"], -1),
        changed(["updates"], 1.5),
        changed(["updates"], None),
        changed(["checks"], [7]),
        changed(["checks", 0, "aoi"], "high"),
        changed(["curve"], []),
        changed(["curve", "episodes"], [6, 12]),
        changed(["curve", "episodes"], [-6]),
        changed(["curve", "reward", "monitoring"], None),
        changed(["evaluation"], None),
        changed(["evaluation", "first_farm"], 0),
        changed(["evaluation", "farms"], 4),
        changed(["evaluation", "reward"], [1.0, 2.0]),
        changed(["evaluation", "reward"], [1.0, 2.0, float("nan")]),
        changed(["evaluation", "reward"], [1.0, 2.0, 1e999]),
        changed(["evaluation", "types", "monitoring"], [1.0, True, 2.0]),
        changed(["evaluation", "metrics", "energy_j"], None),
        changed(["overestimation"], [1.0]),
        changed(["compared_value"], 3),
    ],
)
def test_a_record_whose_result_is_not_whole_counts_as_missing(change, bench, capfd):
    """Each part of a training's result is looked at, and the message says which file it is."""
    job = bench.runs(EIA_SEC, 1)[0]
    result = trained(FIRST_FARM, [1.0, 2.0, 3.0])
    bench.records.put(job, MADE, 1.0, result)
    assert bench.records.missing([job]) == []
    change(result)
    bench.records.put(job, MADE, 1.0, result)
    assert bench.records.missing([job]) == [job]
    assert f"{job.digest}.json" in capfd.readouterr().err


@pytest.mark.parametrize(
    "result", [{}, {**TIMES, "decide": 2.0}, {**TIMES, "separate": {**TIMES["separate"], "q95": "a"}}]
)
def test_a_timing_that_is_not_whole_counts_as_missing(result, bench):
    """All times of all pieces are there."""
    bench.records.put(timing(bench), MADE, 1.0, result)
    assert bench.records.missing([timing(bench)]) == [timing(bench)]


def test_a_training_that_is_flown_needs_its_policy(bench):
    """Without the policy file, from which paths are drawn, its record is enough for every other study."""
    job = bench.runs(EIA_SEC, 1)[0]
    bench.records.put(job, MADE, 1.0, trained(FIRST_FARM, [1.0, 2.0, 3.0]))
    assert bench.records.missing([job]) == []
    assert bench.records.missing([job], flown=True) == [job]
    actors = TeamActors.initial(farm_team(job.config.farm), 16, 0)
    save_policy(bench.records.path(job, POLICY_SUFFIX), actors, {})
    assert bench.records.missing([job], flown=True) == []
    assert [name for name, study in STUDIES.items() if study.flies] == ["trajectories"]
    bench.records.forget(job)
    bench.records.forget(job)
    assert bench.records.missing([job]) == [job]


@pytest.mark.parametrize("name", ["ablation", "scalability", "default"])
def test_kept_records_are_found_by_their_study(name, tmp_path):
    """The archive that is kept with the results, unpacked, has all that these pages were made from."""
    folder = Path(__file__).resolve().parents[3] / "research" / "results" / "reproduce"
    # Pythons before 3.11.4 know no filter, and the archive is our own.
    safely = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
    with tarfile.open(folder / "records.tar.xz") as kept:
        kept.extractall(tmp_path, **safely)
    data = json.loads((folder / name / "results.json").read_text())
    teams = tuple(int(uavs) for uavs in data.get("teams", {})) or FULL.uavs
    seeds = {kind: data["sizes"][kind] for kind in ("seeds", "side_seeds", "team_seeds")}
    bench = Bench(replace(FULL, uavs=teams, **seeds), Records(tmp_path))
    assert bench.choice(EIA_SEC) == data["choice"][EIA_SEC.name]["chosen"]
    assert [job.label for stage in STUDIES[name].stages(bench) for job in bench.records.missing(stage)] == []


@pytest.mark.parametrize("scale", [SMOKE, FULL], ids=lambda scale: scale.name)
def test_every_method_is_tuned_and_trained_alike(scale, tmp_path):
    """Candidates, seeds, farms, farm, processes and budget are the same; trials are longer where methods are slower."""
    bench = Bench(scale, Records(tmp_path))
    methods = (*ABLATIONS, *PEERS)
    late = [method.name for method in methods if method.late]
    assert late == ["EIA only", "neither", "MADDPG", "MATD3", "MASAC"]
    assert scale.trial_episodes < scale.long_trial_episodes < scale.episodes
    trials = [[bench.trials(method) for method in methods if method.late is slow] for slow in (False, True)]
    for jobs in (*trials, [bench.runs(method, 2) for method in methods]):
        assert len({len(own) for own in jobs}) == 1
        for alike in zip(*jobs, strict=True):
            configs = [job.config for job in alike]
            assert len({json.dumps(dict(job.options)) for job in alike}) == 1
            for part in ("seed", "farm", "replay", "rollout", "exploration", "learner"):
                assert len({getattr(config, part) for config in configs}) == 1
            assert len({config.elite for config in configs if config.imitates}) <= 1
            spent = [budget(config) for config in configs]
            assert max(spent) - min(spent) <= configs[0].elite.farms + configs[0].rollout.environments


@pytest.mark.parametrize("scale", [SMOKE, FULL], ids=lambda scale: scale.name)
def test_methods_on_policy_have_the_farm_the_seeds_and_the_budget_of_the_others(scale, tmp_path):
    """MAPPO and IPPO differ from the paper's methods in how they learn alone, and earn the farm's own reward."""
    bench = Bench(scale, Records(tmp_path))
    peers, ours = bench.runs(PEERS[0], 2), [bench.runs(method, 2) for method in ON_POLICY_PEERS]
    for own in ours:
        for peer, job in zip(peers, own, strict=True):
            assert (job.config.seed, job.config.farm, job.options) == (peer.config.seed, peer.config.farm, peer.options)
            assert 0 <= budget(peer.config) - budget(job.config) < job.config.rollout.environments
            assert not job.config.on_policy.hindsight
    assert [len(bench.trials(method)) for method in ON_POLICY_PEERS] == [scale.candidates] * 2


def budget(config):
    """Return the episodes that a run takes, those of its imitation events included."""
    schedule, events = ImitationSchedule.of(config), 0
    while (due := schedule.due_episode(events + 1)) is not None and due <= config.episodes:
        events += 1
    return config.episodes + events * min(config.elite.farms, config.rollout.train_farms)


@pytest.mark.parametrize("episodes", [8, 16, 40, 48, 100, 313, 2000])
@pytest.mark.parametrize("farms", [1, 4, 20])
def test_imitation_pays_for_its_evaluations(episodes, farms):
    """The budget holds, and one more batch of training episodes would break it."""
    base = replace(FULL.base(), elite=EliteConfig(cycle=10, farms=farms))
    config = configuration(base, EIA_SEC, "as the preset", 0, episodes)
    batch = base.rollout.environments
    assert config.episodes == training_episodes(config, episodes)
    assert config.episodes % batch == 0
    assert budget(config) <= episodes
    assert budget(replace(config, episodes=config.episodes + batch)) > episodes
    peer = configuration(base, PEERS[0], "as the preset", 0, episodes)
    assert peer.episodes == episodes // batch * batch


def test_candidates_change_what_they_say():
    """The first candidate is the preset itself; every other one multiplies one field."""
    base = FULL.base()
    preset, *others = (configuration(base, EIA_SEC, name, 0, 100).algorithm for name in CANDIDATES)
    assert preset == base.algorithm
    for algorithm, factors in zip(others, list(CANDIDATES.values())[1:], strict=True):
        ((field, factor),) = factors.items()
        assert getattr(algorithm, field) == pytest.approx(getattr(preset, field) * factor)
        assert replace(algorithm, **{field: getattr(preset, field)}) == preset


@pytest.mark.parametrize(("uavs", "split"), [(6, (2, 2, 2)), (16, (6, 5, 5)), (20, (7, 7, 6)), (96, (32, 32, 32))])
def test_teams_are_split_evenly(uavs, split):
    """What does not go into three goes to communication UAVs first."""
    world = with_uavs(FULL.base(), uavs).farm.world
    assert (world.communication_uavs, world.monitoring_uavs, world.collection_uavs) == split


@pytest.mark.parametrize("scale", [SMOKE, FULL], ids=lambda scale: scale.name)
def test_reported_farms_and_seeds_are_seen_by_nothing_else(scale, tmp_path):
    """Training farms, farms of choice and flown farms are apart, and no reported run has the trials' seed."""
    bench = Bench(scale, Records(tmp_path))
    assert bench.base().rollout.train_farms <= CHOICE_FARM
    assert CHOICE_FARM + scale.choice_farms <= FIRST_FARM
    jobs = {job.digest: job for study in STUDIES.values() for stage in study.stages(bench) for job in stage}.values()
    for job in jobs:
        if job.kind == "train":
            assert job.options["farms"][0] == (CHOICE_FARM if job.config.seed == TRIAL_SEED else FIRST_FARM)
            assert job.options["choice_farms"][0] == CHOICE_FARM
            assert (job.config.learner.threads, job.config.rollout.threads) == (1, 1)


def test_farms_that_had_their_say_are_left_out_of_all_results(bench):
    """Runs, references and both ends of the scale leave them out; what the best heuristic is follows from the rest."""
    first = FIRST_FARM
    rewards = {"random": [900.0, -10.0, -30.0], "greedy": [0.0, 100.0, 300.0], "lawnmower": [990.0, 90.0, 110.0]}
    for job in bench.references():
        bench.records.put(job, MADE, 1.0, flown(first, rewards[job.options["policy"]]))
    random, best, name = bench.ends()
    assert name == "greedy"
    assert (random.tolist(), best.tolist()) == ([-10.0, -30.0], [100.0, 300.0])
    (run,) = bench.runs(EIA_SEC, 1)
    bench.records.put(run, MADE, 1.0, trained(first, [1e6, 20.0, 40.0]))
    save_policy(bench.records.path(run, POLICY_SUFFIX), TeamActors.initial(farm_team(run.config.farm), 16, 0), {})
    assert bench.scores([run]).tolist() == [[20.0, 40.0]]
    (found,) = bench.evaluations([run])
    assert (found["types"]["monitoring"], found["metrics"]["aoi"]) == ([20.0, 40.0], [0.2, 0.4])
    policies = reference_summary(bench)["policies"]
    assert policies["greedy"]["reward"] == 200.0
    assert policies["greedy"]["commit"] == MADE["commit"]
    assert [policies[policy]["normalised"] for policy in ("random", "greedy")] == [0.0, 1.0]


def test_what_is_left_out_changes_no_job(tmp_path):
    """Records of runs that were finished before stay valid: every job flies the same farms as it did."""
    assert (FIRST_REPORTED, FULL.reported) == (1020, range(1020, 1100))
    before, now = (Bench(replace(FULL, left_out=left_out), Records(tmp_path)) for left_out in (0, FULL.left_out))
    for study in STUDIES.values():
        digests = [{job.digest for stage in study.stages(bench) for job in stage} for bench in (before, now)]
        assert digests[0] == digests[1]


def test_studies_share_their_runs(tmp_path):
    """EIA-SEC's runs with 12 UAVs and k_s = 2 are the same in every study that has them."""
    bench = Bench(FULL, Records(tmp_path))
    runs = {job.digest for job in bench.runs(EIA_SEC, 1)}
    for name in ("training", "ablation", "ensemble", "scalability", "trajectories"):
        assert runs <= {job.digest for stage in STUDIES[name].stages(bench) for job in stage}, name


def test_the_preset_eia_sec_is_trained_as_it_is(tmp_path):
    """Its runs are those of `train --preset eia-sec --seed N`; those beside them are EIA-SEC's of `training`."""
    bench = Bench(FULL, Records(tmp_path))
    runs = bench.preset_runs(FULL.seeds)
    assert [job.config for job in runs] == [replace(PRESETS["eia-sec"], seed=seed) for seed in range(FULL.seeds)]
    wanted = {job.digest for job in (*runs, *bench.runs(EIA_SEC, FULL.seeds))}
    trained = [job for stage in STUDIES["default"].stages(bench) for job in stage if job.kind == "train"]
    assert wanted == {job.digest for job in trained if job.config.seed != TRIAL_SEED}
    assert SMOKE.preset().episodes == SMOKE.episodes
    assert SMOKE.preset().farm.observation.mirrored


def test_seeds_and_teams_can_be_asked_for():
    """The scale has what was said, 12 UAVs in any case; without a word it is the scale itself."""
    assert ReproduceArguments("scalability").sizes() == FULL
    asked = ReproduceArguments("scalability", uavs=(24, 6), seeds=1).sizes()
    assert (asked.uavs, asked.seeds, asked.side_seeds, asked.team_seeds) == ((6, 12, 24), 1, 1, 1)
    assert asked.view_seeds == 1
    own = {name: getattr(FULL, name) for name in ("uavs", "seeds", "side_seeds", "team_seeds", "view_seeds")}
    assert replace(asked, **own) == FULL
