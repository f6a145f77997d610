"""The paper's claims of methods: verdicts follow from numbers by their rules."""

import copy

import pytest

from research.studies.analysis.claims import CLAIMS, ablation, heuristics, training
from research.studies.analysis.paper import INFERENCE_BY_METHOD, INFERENCE_BY_UAVS, REWARD_BY_MEMBERS, REWARD_BY_UAVS
from research.studies.analysis.verdicts import NOT_RUN


@pytest.mark.parametrize("study", CLAIMS)
def test_without_results_nothing_is_claimed(study):
    """A study that was not run at full scale says so in every row, and nothing is decided."""
    rows = CLAIMS[study](None)
    assert rows
    assert {row.ours for row in rows} == {NOT_RUN}
    assert {row.verdict for row in rows} == {"undecided"}


def test_every_number_of_the_paper_has_its_row():
    """Times and rewards by number of UAVs, times by method, and rewards by k_s."""
    text = " ".join(row.paper for name in CLAIMS for row in CLAIMS[name](None))
    numbers = [
        *INFERENCE_BY_UAVS.values(),
        *REWARD_BY_UAVS.values(),
        *INFERENCE_BY_METHOD.values(),
        *REWARD_BY_MEMBERS.values(),
    ]
    assert [number for number in numbers if f"{number}" not in text] == []


def method(level, aoi=1.0, converged=500.0, unrest=10.0, farms=20.0, over=1.0):
    interval = (level, level - 1.0, level + 1.0)
    figure = (aoi, aoi - 0.01, aoi + 0.01)
    runs = [
        {
            "reward": level + seed,
            "metrics": {"aoi": aoi + 0.001 * seed, "vdf": aoi + 0.001 * seed},
            "farm_spread": farms + 0.1 * seed,
            "converged": converged if converged is None else converged + seed,
            "diverged": False,
            "unrest": unrest + 0.1 * seed,
            "overestimation": {"monitoring": over + 0.001 * seed, "collection": over},
        }
        for seed in (0, 1)
    ]
    return {
        "normalised": (level / 1000.0,) * 3,
        "reward": interval,
        "mean_reward": interval,
        "metrics": {"aoi": figure, "vdf": figure},
        "farm_spread": farms,
        "runs": runs,
    }


REFERENCES = {"best": "horizon", "policies": {"horizon": {"reward": 1400.0}, "random": {"reward": 400.0}}}


SIZES = {"farms": 100, "trial_episodes": 200}


def study(**first):
    names = ("MADDPG", "MATD3", "MASAC")
    methods = {
        "EIA-SEC": method(**{"level": 900.0, "aoi": 0.5, "converged": 300.0, "unrest": 5.0, "farms": 9.0, **first})
    }
    methods |= {name: method(600.0 + place) for place, name in enumerate(names)}
    return {"methods": methods, "references": REFERENCES, "sizes": SIZES}


def test_verdicts_on_training_turn_with_the_numbers():
    """What the paper found holds when we find it, and does not when we find the opposite."""
    same = [row.verdict for row in training(study())]
    assert same == ["holds"] * 7 + ["undecided"]
    opposite = training(study(level=100.0, aoi=2.0, converged=900.0, unrest=50.0, farms=90.0))
    refuted = "does not hold"
    wanted = [refuted, "holds", refuted, refuted, "holds in part", refuted, refuted, "undecided"]
    assert [row.verdict for row in opposite] == wanted


def test_a_clear_but_small_lead_holds_in_part():
    """Above every peer by less than what counts as alike is above, and not far above; the same gap is named once."""
    far_above, alike_peers, *_ = training(study(level=665.0))
    assert far_above.verdict == "holds in part"
    assert "MADDPG 0.06 (0.06..0.07)" in far_above.why
    data = study()
    data["methods"]["MASAC"] = method(665.0)
    assert training(data)[1].verdict == alike_peers.verdict == "holds"
    data["methods"]["MASAC"] = method(800.0)
    assert training(data)[1].verdict == "holds in part"


def test_one_seed_that_is_worse_leaves_it_open():
    """Where the seeds of two methods overlap, the probability of improvement does not decide, and no verdict does."""
    data = study()
    for runs in (data["methods"][name]["runs"] for name in ("EIA-SEC", "MADDPG")):
        runs[0] = dict(runs[0], converged=450.0, unrest=7.0)
    for name in ("MATD3", "MASAC"):
        data["methods"][name] = copy.deepcopy(data["methods"]["MADDPG"])
    rows = {row.paper: row for row in training(data)}
    assert rows["M2: EIA-SEC converges first"].verdict == "undecided"
    assert "MADDPG 0.88 (0.50..1.00)" in rows["M2: EIA-SEC converges first"].why
    assert rows["M3: EIA-SEC is the steadiest"].verdict == "holds in part"  # over farms it is, for every seed


def test_counted_farm_by_farm_where_the_results_hold_it():
    """What was counted on each farm goes before the runs' means, in either order of the methods."""
    data = study()
    data["pairs"] = {"reward": {"EIA-SEC": {"MADDPG": (0.2, 0.1, 0.3)}}, "aoi": {"MATD3": {"EIA-SEC": (0.9, 0.8, 1.0)}}}
    reward, _, aoi, *_ = training(data)
    assert "MADDPG 0.20 (0.10..0.30)" in reward.why
    assert "MATD3 0.10 (0.00..0.20)" in aoi.why
    assert aoi.verdict == "holds in part"
    assert "hold no farm's values" in aoi.why


def test_the_control_stands_beside_the_lead():
    """How much of the lead over the best peer is there without either part, and only when the ablation is there."""
    control = {"methods": {"neither": method(840.0)}, "sizes": SIZES}
    row = training(study(), control)[0]
    assert "so 80% of the lead over MASAC is there without EIA and SEC: most of it" in row.why
    assert "each of its runs more than every run of the peers" in row.why
    assert "differ" not in row.why
    low = training(study(), {"methods": {"neither": method(602.0)}, "sizes": {**SIZES, "first_farm": 1020}})[0]
    assert "(the two studies differ in their farms)" in low.why
    assert "so 0% of the lead over MASAC is there without EIA and SEC" in low.why
    assert "most of it" not in low.why
    assert "each of its runs" not in low.why
    assert "Control" not in training(study())[0].why


def test_a_seed_that_never_converges_is_not_in_time():
    """One late seed of two leaves it open for that method; never is shown as never."""
    data = study()
    data["methods"]["MATD3"]["runs"] = [dict(data["methods"]["MATD3"]["runs"][0], converged=None)] * 2
    row = training(data)[4]
    assert row.verdict == "holds in part"
    assert "MATD3 never" in row.ours


def test_what_results_do_not_hold_stays_open():
    """Results without the seeds' own spread over farms leave that half open, and say so."""
    data = study()
    for found in data["methods"].values():
        found["runs"] = [{key: value for key, value in run.items() if key != "farm_spread"} for run in found["runs"]]
    row = training(data)[6]
    assert row.verdict == "holds in part"
    assert "that half is open" in row.why


def parts(**changed):
    levels = {
        "EIA-SEC": {"level": 900.0, "converged": 300.0},
        "EIA only": {"level": 800.0, "converged": 400.0},
        "SEC only": {"level": 850.0, "converged": 350.0, "over": 0.5},
        "neither": {"level": 700.0, "converged": 600.0, "over": 2.0},
    }
    return {"methods": {name: method(**{**own, **changed.get(name, {})}) for name, own in levels.items()}}


def test_verdicts_on_the_ablation_turn_with_the_numbers():
    """Both best, neither worst and slowest, less overestimation: each holds when found, not when the opposite is."""
    assert [row.verdict for row in ablation(parts())] == ["holds"] * 4
    other = {"EIA-SEC": {"level": 650.0, "converged": 700.0}, "SEC only": {"over": 5.0}}
    wanted = ["does not hold", "holds in part", "holds in part", "does not hold"]
    assert [row.verdict for row in ablation(parts(**other))] == wanted
    last = {name: {"level": 100.0, "converged": 900.0} for name in ("EIA-SEC", "EIA only", "SEC only")}
    assert [row.verdict for row in ablation(parts(**last))][1:3] == ["does not hold", "does not hold"]


def test_seeds_that_overlap_leave_the_ablation_open():
    """Equal methods are neither best nor worst, nor faster, nor less wrong."""
    equal = {name: {"level": 800.0, "converged": 400.0, "over": 1.0} for name in parts()["methods"]}
    assert [row.verdict for row in ablation(parts(**equal))] == ["undecided"] * 4


def test_overestimation_is_compared_in_units_of_reward():
    """A method with three times the reward scale is divided by it, by what was chosen or by what its runs record."""
    data = parts(neither={"over": 1.2}, **{"SEC only": {"over": 0.6}})
    assert ablation(data)[3].verdict == "holds"
    data["choice"] = {"neither": {"chosen": "reward scale x 3"}, "SEC only": {"chosen": "actor rate x 3"}}
    row = ablation(data)[3]
    assert row.verdict == "does not hold"
    assert row.ours == "SEC only 6.0, neither 4.0"
    assert "Q_i, the agent's own critic" in row.why
    for name, scale in (("SEC only", 0.6), ("neither", 0.1)):
        for run in data["methods"][name]["runs"]:
            run |= {"reward_scale": scale, "compared_value": "mixture"}
    row = ablation(data)[3]
    assert row.verdict == "holds"
    assert row.ours == "SEC only 1.0, neither 12.0"
    assert "Q is Q_P, the mixture" in row.why
    data["methods"]["neither"]["runs"][0]["overestimation"] = {}
    assert ablation(data)[3].verdict == "undecided"


def test_heuristics_fail_only_when_they_do():
    """They are judged by the study, and as long as it is missing by the policy that ships."""
    flown = {
        "results": [
            {"policy": "trained:instant", "reward": (997, 988, 1004)},
            {"policy": "horizon", "reward": (1419, 1416, 1421)},
        ]
    }
    (row,) = heuristics(None, flown)
    assert row.verdict == "does not hold"
    assert "1419" in row.ours
    assert heuristics(study(level=1500.0), flown)[0].verdict == "holds in part"
    assert heuristics(study(level=1400.5), flown)[0].verdict == "undecided"
    assert heuristics(None, None)[0].ours == NOT_RUN
