"""The page on monitoring says what the declarations say, and the declarations name what there is."""

import dataclasses

from eia_sec.common.protocol import keys, messages, metrics
from eia_sec.common.protocol.metrics import Metric, undeclared
from eia_sec.deploy.monitor import snapshot
from research.pages.monitoring_tables import attribute_docs, messages_tables


def test_every_field_on_the_page_is_explained():
    """Every field of every message and record that can be read has its meaning from the docstring."""
    readable = {name for f in keys.FAMILIES if f.delivery in ("state", "lossy") for name in f.messages}
    kinds = [getattr(messages, name) for name in ("Envelope", *readable)]
    kinds += [kind for kind in vars(snapshot).values() if dataclasses.is_dataclass(kind)]
    for kind in kinds:
        assert [item.name for item in dataclasses.fields(kind) if not attribute_docs(kind).get(item.name)] == []
    page = messages_tables()
    assert all(f"### {name}," in page for name in readable)


def test_names_are_held_against_the_declaration(monkeypatch):
    """Nested names are joined, a star covers one name or a rest with slashes, and anything else is found."""
    declared = tuple(Metric(name, "", "") for name in ("a", "b/c", "d/*", "e/*/f"))
    monkeypatch.setitem(metrics.METRICS, "learner", declared)
    assert undeclared("learner", {"a": 1, "b": {"c": 2}, "d": {"x/y": 3}, "e": {"g": {"f": 4}}}) == []
    assert undeclared("learner", {"b": 1, "e": {"g": {"h": 2}}, "z": {}}) == ["b", "e/g/h"]
    assert undeclared("nobody", {"a": 1}) == ["a"]
