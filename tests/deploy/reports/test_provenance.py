"""What a result says of the packages that made it."""

from importlib.metadata import version

from eia_sec.deploy.reports.provenance import PACKAGES, made_by, versions


def test_an_environments_package_counts():
    """It is found by the environment's module; what is no installed package is left out."""
    found = versions(("mpe2:simple_spread_v3", "mytask.env:Cover", "numpy.random:Generator"))
    assert found["packages"] == {name: version(name) for name in (*PACKAGES, "mpe2")}
    assert made_by("eia-sec benchmark", ["--seeds", "2"])["command"] == "eia-sec benchmark --seeds 2"
