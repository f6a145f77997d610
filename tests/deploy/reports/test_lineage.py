"""Who imitated whom: sentences, and a picture with an arrow for each imitation."""

from matplotlib.figure import Figure

from eia_sec.deploy.reports.lineage import exploits, lineage, sentences


def event(number, scores, rate, *sources):
    """Return a round of a member with this learning rate after it."""
    return {
        "kind": "exploit",
        "round": number,
        "scores": scores,
        "rate": 1.0 if sources else 0.0,
        "sources": dict(sources),
        "hyperparameters": {"actor_rate": rate},
        "before": {"actor_rate": 1e-3},
    }


FIRST, SECOND = {"m0": 1.0, "m1": 2.0}, {"m0": 3.0, "m1": 2.5}
MEMBERS = {
    "m0": [event(1, FIRST, 2e-3, ("monitoring", "m1"), ("collection", "m1")), event(2, SECOND, 2e-3)],
    "m1": [event(1, FIRST, 1e-3), event(2, SECOND, 4e-3, ("monitoring", "m0"))],
}


def test_each_imitation_is_a_sentence():
    """The oldest first, with what hyperparameters became."""
    assert exploits([{"kind": "status"}, *MEMBERS["m0"]]) == MEMBERS["m0"]
    assert sentences(MEMBERS) == [
        "round 1: m0 imitated monitoring of m1, collection of m1, share 1; actor_rate 0.001 to 0.002",
        "round 2: m1 imitated monitoring of m0, share 1; actor_rate 0.001 to 0.004",
    ]


def test_the_picture_has_an_arrow_for_each_imitation(tmp_path, monkeypatch):
    """From whom was imitated to who did, a line for each member, and a panel for each hyperparameter."""
    kept = []
    saved = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda figure, path: (kept.append(figure), saved(figure, path)))
    lineage(MEMBERS, tmp_path / "lineage.png", "two")
    top, rate = kept[0].axes
    assert [list(line.get_ydata()) for line in top.lines] == [[1.0, 3.0], [2.0, 2.5]]
    assert [(text.xy, text.xyann) for text in top.texts] == [((1, 1.0), (1, 2.0)), ((2, 2.5), (2, 3.0))]
    assert [list(line.get_ydata()) for line in rate.lines] == [[2e-3, 2e-3], [1e-3, 4e-3]]
    assert (tmp_path / "lineage.png").stat().st_size > 5_000
