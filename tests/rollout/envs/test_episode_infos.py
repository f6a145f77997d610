"""Numbers in an environment's infos become metrics of its episodes, within limits that are counted."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mytask.env import Cover

from eia_sec.common.config import EnvConfig
from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.chunk_messages import from_message, to_message
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import MOST_INFOS, TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from eia_sec.deploy.monitor.environment_labels import plotted, value_of
from eia_sec.learner.process.curves import Curves
from eia_sec.rollout.envs.episode_infos import EpisodeInfos
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch

TEAM = TeamSpec((GroupSpec("walker", 1, 2, 1),))


def test_a_metric_is_the_mean_over_steps_and_agents():
    """Numbers of every kind count; masks and texts are no metrics; another episode begins anew."""
    infos = EpisodeInfos(2, "mytask.env:Cover")
    infos.add(0, {"a": {"won": False, "mask": np.ones(3), "name": "x"}, "b": {"won": np.bool_(True)}})
    infos.add(0, {"a": {"won": True, "left": np.float32(2.0)}, "b": {"won": 1}})
    infos.add(1, {"a": {"won": 0.0}})
    assert infos.means(0) == {"won": 0.75, "left": 2.0}
    assert infos.means(1) == {"won": 0.0}
    infos.begin(0)
    assert infos.means(0) == {}
    assert infos.alarm == ""


def test_what_is_refused_is_counted_and_named(capsys):
    """Names beyond the limit, names that are none and impossible values are counted; one line is logged, once."""
    infos = EpisodeInfos(1, "mytask.env:Cover")
    infos.add(0, {"a": {f"n{k}": 1.0 for k in range(MOST_INFOS + 2)}})
    infos.add(0, {"a": {"a b": 1.0, 3: 1.0, "n0": math.nan, "n1": 1e30, "n2": 10**400}})
    assert len(infos.means(0)) == MOST_INFOS
    assert infos.refused == 7
    assert infos.alarm.startswith("mytask.env:Cover: 7 numbers in infos are no metrics, among them '3', 'a b', 'n0'")
    assert capsys.readouterr().err.count("are no metrics") == 1


def test_an_episode_of_an_environment_has_them():
    """A batch's summary holds what its environment says of its steps."""
    batch = PettingZooBatch(EnvConfig("mytask.env:Cover", '{"agents": 1, "size": 2}'), 1, boxes=False)
    batch.reset(0, 0, 0)
    seen = []
    while not batch.ended.all():
        batch.step(np.zeros((1, 1), np.float32))
        seen.append(1.0 + batch.reward[0, 0])
    assert batch.summary(0).infos == {"covered": pytest.approx(np.mean(seen))}
    assert isinstance(Cover(), type(batch._environments[0].wrapped))


def chunk(*infos):
    flag = np.array([TRANSITION | TRUNCATED, 0] * len(infos), np.uint8)
    count = len(flag)
    rows = Rows(
        np.zeros((count, 2), np.float32), np.zeros((count, 1), np.float32), np.zeros((count, 1), np.float32), flag
    )
    return Chunk(rows, tuple(EpisodeSummary(k, 0, 1, (0.0,), {}, each) for k, each in enumerate(infos)))


def test_they_travel_with_a_chunk():
    """Episodes may have different names; each arrives with its own."""
    sent = chunk({"won": 1.0}, {}, {"won": 0.0, "left": 3.0})
    message = type(to_message(sent, TEAM, 1, 3)).decode(to_message(sent, TEAM, 1, 3).encode())
    assert [dict(e.infos) for e in from_message(message, TEAM, ()).episodes] == [dict(e.infos) for e in sent.episodes]


@pytest.mark.parametrize(
    "change",
    [
        {"info_names": ("won", "won"), "infos": np.zeros((1, 2))},
        {"info_names": ("a b",)},
        {"info_names": tuple(f"n{k}" for k in range(MOST_INFOS + 1)), "infos": np.zeros((1, MOST_INFOS + 1))},
        {"infos": np.full((1, 1), np.inf)},
        {"infos": np.full((1, 1), 1e30)},
        {"infos": np.zeros((2, 1))},
        {"info_names": None},
    ],
)
def test_malformed_ones_are_refused(change):
    """Twice a name, a name that is none, too many, impossible values, other shapes."""
    message = replace(to_message(chunk({"won": 1.0}), TEAM, 1, 1), **change)
    with pytest.raises(SchemaError, match="numbers in infos"):
        from_message(message, TEAM, ())


def test_curves_and_views_show_them():
    """Means are over the episodes that have a number; a view without other metrics shows them."""
    curves = Curves(TEAM)
    curves.add(chunk({"won": 1.0}, {}, {"won": 0.0, "left": 3.0}).episodes)
    found = curves.smoothed()
    assert found["infos"] == {"won": 0.5, "left": 3.0}
    first, second = plotted({"curves": found})
    assert (first.name, value_of(found, first)) == ("infos/left", 3.0)
    assert (second.label, value_of(found, second)) == ("won", 0.5)
    assert "infos" not in curves.add(chunk({}).episodes)
