"""The comparison with the paper: verdicts follow from numbers by their rules, and the page is up to date."""

import copy
from pathlib import Path

import pytest

from deploy.studies.claims import CLAIMS, ablation, heuristics, inference, members, scalability, training, trajectories
from deploy.studies.comparison_page import BEGIN, END, PAGE, block, refreshed
from deploy.studies.paper import INFERENCE_BY_METHOD, INFERENCE_BY_UAVS, REWARD_BY_MEMBERS, REWARD_BY_UAVS
from deploy.studies.verdicts import NOT_RUN, above, alike, best_of, full, judged, lower

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("answers", "verdict"),
    [
        ([True, True], "holds"),
        ([True, None], "holds in part"),
        ([True, False], "holds in part"),
        ([False, None], "does not hold"),
        ([False], "does not hold"),
        ([None, None], "cannot be told"),
    ],
)
def test_verdicts_on_several_answers(answers, verdict):
    """All, some, none, and open throughout."""
    assert judged(answers) == verdict


def test_intervals_decide():
    """Only an interval that excludes the other side is an answer."""
    assert [above(p) for p in ((0.9, 0.6, 1.0), (0.1, 0.0, 0.4), (0.6, 0.4, 0.8))] == [True, False, None]
    assert lower((1, 0, 2), (4, 3, 5)) is True
    assert lower((4, 3, 5), (1, 0, 2)) is False
    assert lower((1, 0, 3.5), (4, 3, 5)) is None


@pytest.mark.parametrize(
    ("ours", "verdict"), [(0.80, "holds"), (0.83, "holds"), (0.95, "holds in part"), (1.01, "does not hold")]
)
def test_ratios_agree_within_five_percent(ours, verdict):
    """Beside the paper's 0.81: within the tolerance, on the same side of 1, on the other."""
    assert alike(0.81, ours) == verdict


@pytest.mark.parametrize(("ours", "verdict"), [(1.01, "holds"), (0.94, "holds"), (0.46, "does not hold")])
def test_a_ratio_near_one_has_no_side(ours, verdict):
    """Beside the paper's 0.98, which says that nothing changes, half as much is no agreement."""
    assert alike(0.98, ours) == verdict


def test_the_best_of_several():
    """It has to be the first, and clearly, and another has to be clearly above it to refute that."""
    clear = {"1": (5, 4, 6), "2": (9, 8, 10)}
    assert best_of(clear, "2") == "holds"
    assert best_of(clear, "1") == "does not hold"
    close = {"1": (5, 3, 7), "2": (6, 4, 8)}
    assert best_of(close, "2") == "holds in part"
    assert best_of(close, "1") == "cannot be told"


@pytest.mark.parametrize("study", CLAIMS)
def test_without_results_nothing_is_claimed(study):
    """A study that was not run at full scale says so in every row, and nothing can be told."""
    rows = CLAIMS[study](None)
    assert rows
    assert {row.ours for row in rows} == {NOT_RUN}
    assert {row.verdict for row in rows} == {"cannot be told"}


def test_smoke_results_are_no_results():
    """Only the full scale counts."""
    assert full({"scale": "smoke"}) is None
    assert full(None) is None
    assert full({"scale": "full"}) is not None


def test_every_number_of_the_paper_has_its_row():
    """Times and rewards by number of UAVs, times by method, and rewards by k_s."""
    told = " ".join(row.paper for name in CLAIMS for row in CLAIMS[name](None))
    numbers = [
        *INFERENCE_BY_UAVS.values(),
        *REWARD_BY_UAVS.values(),
        *INFERENCE_BY_METHOD.values(),
        *REWARD_BY_MEMBERS.values(),
    ]
    assert [number for number in numbers if f"{number}" not in told] == []


def method(level, aoi=1.0, converged=500.0, unrest=10.0):
    interval = (level, level - 1.0, level + 1.0)
    figure = (aoi, aoi - 0.01, aoi + 0.01)
    run = {"converged": converged, "diverged": False, "unrest": unrest}
    return {
        "normalised": (level / 1000.0,) * 3,
        "reward": interval,
        "mean_reward": interval,
        "figures": {"aoi": figure, "vdf": figure},
        "farm_spread": 20.0,
        "runs": [run, run],
    }


def study(**first):
    names = ("MADDPG", "MATD3", "MASAC")
    methods = {"EIA-SEC": method(**{"level": 900.0, "aoi": 0.5, "converged": 300.0, "unrest": 5.0, **first})}
    methods |= {name: method(600.0 + place) for place, name in enumerate(names)}
    better = (1.0, 1.0, 1.0) if methods["EIA-SEC"]["reward"][0] > 700.0 else (0.0, 0.0, 0.0)
    best = {"reward": 1400.0}
    return {
        "methods": methods,
        "improvement": dict.fromkeys(names, better),
        "references": {"best": "horizon", "policies": {"horizon": best}},
    }


def test_verdicts_on_training_turn_with_the_numbers():
    """What the paper found holds when we find it, and does not when we find the opposite."""
    same = [row.verdict for row in training(study())]
    assert same == ["holds"] * 6 + ["holds in part", "cannot be told"]  # spreads over farms are equal in this example
    opposite = training(study(level=100.0, aoi=2.0, converged=900.0, unrest=50.0))
    wanted = [
        "does not hold",
        "holds",
        "does not hold",
        "does not hold",
        "holds in part",
        "does not hold",
        "does not hold",
    ]
    assert [row.verdict for row in opposite] == [*wanted, "cannot be told"]


def test_a_seed_that_never_converges_is_not_in_time():
    """One late seed of two leaves it open for that method; never is shown as never."""
    data = study()
    data["methods"]["MATD3"]["runs"] = [dict(data["methods"]["MATD3"]["runs"][0], converged=None)] * 2
    row = training(data)[4]
    assert row.verdict == "holds in part"
    assert "MATD3 never" in row.ours


def ablated(compared, **excess):
    """Return an ablation in which a method overestimates by so much, in the units of its own targets."""
    names = ("EIA-SEC", "EIA only", "SEC only", "neither")
    methods = {name: method(900.0) for name in names}
    for name, found in methods.items():
        value = excess.get(name.replace(" ", "_"), 0.0)
        found["runs"] = [run | {"overestimation": {"a": value}, **compared} for run in found["runs"]]
    chosen = {name: {"chosen": "reward scale x 3" if name == "neither" else "as the preset"} for name in names}
    return {"methods": methods, "improvement": dict.fromkeys(names[1:], (0.5, 0.4, 0.6)), "choice": chosen}


def test_overestimation_is_compared_in_one_unit():
    """Where rewards are scaled by three, so are values; and a row says whose value it was."""
    row = ablation(ablated({}, SEC_only=2.0, neither=4.5))[-1]
    assert (row.ours, row.verdict) == ("SEC only 2.00, neither 1.50", "does not hold")
    assert "Q_i and not the mixture" in row.why
    row = ablation(ablated({"compared_value": "mixture"}, SEC_only=2.0, neither=7.5))[-1]
    assert (row.ours, row.verdict) == ("SEC only 2.00, neither 2.50", "holds")
    assert row.why.endswith("Q is the mixture Q_P")


def test_heuristics_fail_only_when_they_do():
    """They are judged by the study, and as long as it is missing by the policy that ships."""
    flown = {
        "results": [
            {"policy": "trained", "reward": (997, 988, 1004)},
            {"policy": "horizon", "reward": (1419, 1416, 1421)},
        ]
    }
    (row,) = heuristics(None, flown)
    assert row.verdict == "does not hold"
    assert "1419" in row.ours
    beaten = study(level=1500.0)
    assert heuristics(beaten, flown)[0].verdict == "holds in part"
    assert heuristics(None, None)[0].ours == NOT_RUN


def base_among(count, base, claims):
    """Return that all rows hold but that of the number which the others are divided by; that one would always hold."""
    rows = claims(None)
    assert len(rows) == count
    return ["cannot be told" if row.paper.startswith(base) else "holds" for row in rows]


def test_numbers_are_compared_as_ratios():
    """Twice the paper's rewards throughout have the paper's ratios, and hold."""
    teams = {str(n): {"reward": (2 * r, 2 * r - 1, 2 * r + 1)} for n, r in REWARD_BY_UAVS.items()}
    assert [row.verdict for row in scalability({"teams": teams})] == base_among(6, "Reward with 12", scalability)
    del teams["24"]
    some = {row.paper: row.verdict for row in scalability({"teams": teams})}
    assert [paper for paper, verdict in some.items() if verdict == "cannot be told"] == [
        "M4: the reward hardly depends on the number of UAVs, 6 to 24",
        "Reward with 12 UAVs: 895.04",
        "Reward with 24 UAVs: 881.34",
    ]
    methods = {f"k_s = {k}": {"reward": (2 * r, 2 * r - 1, 2 * r + 1)} for k, r in REWARD_BY_MEMBERS.items()}
    assert [row.verdict for row in members({"methods": methods})] == base_among(7, "k_s = 2:", members)
    turned = copy.deepcopy(methods)
    turned["k_s = 10"]["reward"] = (2000, 1999, 2001)
    verdicts = {row.paper: row.verdict for row in members({"methods": turned})}
    assert verdicts["k_s = 2 is the best"] == "does not hold"
    assert verdicts["k_s = 10: 734.32"] == "does not hold"
    turned["k_s = 10"]["reward"] = (-5, -6, -4)
    assert members({"methods": turned})[-1].verdict == "cannot be told"


def test_times_are_compared_as_ratios():
    """A hundredth of the paper's times holds; equal times of all methods refute only that one is the fastest."""
    teams = {str(n): {"decide": ms / 100, "separate": ms / 10} for n, ms in INFERENCE_BY_UAVS.items()}
    methods = {name: {"decide": ms / 100, "separate": ms / 10} for name, ms in INFERENCE_BY_METHOD.items()}
    rows = inference({"teams": teams, "methods": methods})
    assert {row.paper for row in rows if row.verdict != "holds"} == {"12 UAVs: 34.38 ms", "EIA-SEC: 34.38 ms"}
    equal = {name: {"decide": 0.1, "separate": 1.0} for name in INFERENCE_BY_METHOD}
    verdicts = {row.paper: row.verdict for row in inference({"teams": teams, "methods": equal})}
    assert verdicts["M5: MADDPG is the fastest"] == "does not hold"
    assert verdicts["M5: EIA-SEC takes not much longer"] == "holds"


def test_paths_are_judged_by_coverage():
    """Both working types have to cover the field; what regular means is nowhere said, so that stays open."""
    flight = {
        "visited": {"communication": 0.2, "monitoring": 0.95, "collection": 0.5},
        "order": {"communication": 0.3, "monitoring": 0.6, "collection": 0.5},
    }
    rows = trajectories({"farms": {"1000": {"EIA-SEC": flight}}})
    assert [row.verdict for row in rows] == ["holds in part", "cannot be told"]


def test_the_page_is_up_to_date():
    """The block in docs/ is what `make docs` would write."""
    text = (ROOT / PAGE).read_text(encoding="utf-8")
    assert refreshed(text, ROOT) == text, "run `make docs`"


def test_the_block_replaces_only_itself(tmp_path):
    """What stands before and after stays; a repository without results has a block that says so."""
    text = refreshed(f"before\n{BEGIN}\noutdated\n{END}\nafter", tmp_path)
    assert text.startswith(f"before\n{BEGIN}\n")
    assert text.endswith(f"{END}\nafter")
    assert "outdated" not in text
    assert NOT_RUN in block(tmp_path)
