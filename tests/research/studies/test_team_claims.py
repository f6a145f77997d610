"""The paper's claims of teams, times and paths: verdicts follow from numbers by their rules."""

import copy

from research.studies.analysis.claims import members
from research.studies.analysis.paper import INFERENCE_BY_METHOD, INFERENCE_BY_UAVS, REWARD_BY_MEMBERS, REWARD_BY_UAVS
from research.studies.analysis.team_claims import inference, scalability, trajectories


def base_among(count, base, claims):
    """Return that all rows hold but that of the number which the others are divided by; that one would always hold."""
    rows = claims(None)
    assert len(rows) == count
    return ["undecided" if row.paper.startswith(base) else "holds" for row in rows]


def narrow(value):
    return (value, 0.999 * value, 1.001 * value)


def test_rewards_are_compared_as_ratios():
    """Twice the paper's rewards throughout have the paper's ratios, and hold."""
    teams = {str(n): {"reward": narrow(2 * r)} for n, r in REWARD_BY_UAVS.items()}
    assert [row.verdict for row in scalability({"teams": teams})] == base_among(6, "Reward with 12", scalability)
    wide = {n: {"reward": (t["reward"][0], 0.5 * t["reward"][0], 1.5 * t["reward"][0])} for n, t in teams.items()}
    assert {row.verdict for row in scalability({"teams": wide})} == {"undecided"}
    falling = {str(n): {"reward": narrow(1000.0 / n)} for n in REWARD_BY_UAVS}
    assert {row.verdict for row in scalability({"teams": falling})} == {"does not hold", "undecided"}
    del teams["24"]
    some = {row.paper: row.verdict for row in scalability({"teams": teams})}
    assert [paper for paper, verdict in some.items() if verdict == "undecided"] == [
        "M4: the reward hardly depends on the number of UAVs, 6 to 24",
        "Reward with 12 UAVs: 895.04",
        "Reward with 24 UAVs: 881.34",
    ]


def test_members_are_compared_as_ratios():
    """The paper's own numbers hold; ten that are clearly above two refute that two are best."""
    methods = {
        f"k_s = {k}": {"reward": narrow(2 * r), "runs": [{"reward": 2 * r}, {"reward": 2 * r + 1}]}
        for k, r in REWARD_BY_MEMBERS.items()
    }
    assert [row.verdict for row in members({"methods": methods})] == base_among(7, "k_s = 2:", members)
    turned = copy.deepcopy(methods)
    turned["k_s = 10"] = {"reward": narrow(2000.0), "runs": [{"reward": 2000.0}, {"reward": 2001.0}]}
    verdicts = {row.paper: row.verdict for row in members({"methods": turned})}
    assert verdicts["k_s = 2 is the best"] == "does not hold"
    assert verdicts["k_s = 10: 734.32"] == "does not hold"
    turned["k_s = 10"]["runs"] = [{"reward": 1000.0}, {"reward": 3000.0}]
    assert members({"methods": turned})[0].verdict == "undecided"
    turned["k_s = 10"]["reward"] = (-5, -6, -4)
    assert members({"methods": turned})[-1].verdict == "undecided"


def seeds(stacked, separate=None, late=1.5):
    separate = separate or [10 * value for value in stacked]
    return {
        "seeds": [
            {
                "decide": {"median": one, "q95": late * one},
                "separate": {"median": other, "q95": late * other},
            }
            for one, other in zip(stacked, separate, strict=True)
        ]
    }


def near(value):
    return seeds([0.99 * value, value, 1.01 * value])


def test_times_are_compared_as_ratios():
    """A hundredth of the paper's times holds throughout; equal times leave open which is the fastest."""
    teams = {str(n): near(ms / 100) for n, ms in INFERENCE_BY_UAVS.items()}
    methods = {name: near(ms / 100) for name, ms in INFERENCE_BY_METHOD.items()}
    rows = inference({"teams": teams, "methods": methods})
    assert {row.paper for row in rows if row.verdict != "holds"} == {"12 UAVs: 34.38 ms", "EIA-SEC: 34.38 ms"}
    equal = dict.fromkeys(INFERENCE_BY_METHOD, near(0.1))
    verdicts = {row.paper: row.verdict for row in inference({"teams": teams, "methods": equal})}
    assert verdicts["M5: MADDPG is the fastest"] == "undecided"
    assert verdicts["M5: EIA-SEC takes not much longer"] == "holds"
    turned = {**equal, "MADDPG": near(0.2)}
    verdicts = {row.paper: row.verdict for row in inference({"teams": teams, "methods": turned})}
    assert verdicts["M5: MADDPG is the fastest"] == "does not hold"
    noisy = {**equal, "EIA-SEC": seeds([0.1, 0.1, 0.2])}
    verdicts = {row.paper: row.verdict for row in inference({"teams": teams, "methods": noisy})}
    assert verdicts["M5: EIA-SEC takes not much longer"] == "undecided"


def test_times_grow_only_where_the_seeds_agree():
    """Medians that rise by chance are no growth; one seed that is late over its 95 % quantile is one too many."""
    methods = {name: near(0.1) for name in INFERENCE_BY_METHOD}
    noisy = {"6": seeds([0.1, 0.3, 0.2]), "12": seeds([0.15, 0.29, 0.22]), "24": seeds([0.16, 0.31, 0.2])}
    grows, stays, *_ = inference({"teams": noisy, "methods": methods})
    assert grows.verdict == "undecided"
    assert stays.verdict == "holds"
    noisy["24"]["seeds"][1]["separate"]["q95"] = 121.0
    _, stays, *_ = inference({"teams": noisy, "methods": methods})
    assert stays.verdict == "does not hold"
    assert "(2.4..121.0) ms" in stays.ours


def test_paths_are_judged_by_coverage_and_headings():
    """Both working types have to cover the field, and to be more ordered than relays on every farm."""
    flight = {
        "visited": {"communication": 0.2, "monitoring": 0.95, "collection": 0.5},
        "order": {"communication": 0.3, "monitoring": 0.6, "collection": 0.5},
    }
    rows = trajectories({"farms": {"1020": {"EIA-SEC": flight}}})
    assert [row.verdict for row in rows] == ["holds in part", "holds"]
    assert "lattice" not in rows[1].why
    other = copy.deepcopy(flight)
    other["order"] |= {"communication": 0.55}
    data = {"farms": {"1020": {"EIA-SEC": flight}, "1021": {"EIA-SEC": other}}, "monitors_steer_by": "lattice"}
    row = trajectories(data)[1]
    assert row.verdict == "holds in part"  # on the second farm data collection UAVs are the less regular ones
    assert "a lattice of 8 headings, which alone gives an order of 0.25" in row.why
    assert trajectories({"farms": {"1021": {"EIA-SEC": {**other, "order": {**other["order"], "monitoring": 0.1}}}}})[
        1
    ].verdict == ("does not hold")
