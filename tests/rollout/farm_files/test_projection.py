"""Degrees to metres, held against PROJ."""

import numpy as np
import pytest

from eia_sec.rollout.farm_files.projection import TangentPlane

PLACES = [(0.0, 0.0), (11.7, 48.4), (179.9995, -36.8), (-70.0, -54.0), (25.0, 69.5), (-95.0, 84.9)]


def scatter(side):
    return np.random.default_rng(1).uniform(-side / 2, side / 2, (300, 2))


@pytest.mark.parametrize("place", PLACES)
def test_metres_are_those_of_proj(place):
    """Ellipsoidal orthographic coordinates equal PROJ's to a micrometre, and lead back to where they came from."""
    pyproj = pytest.importorskip("pyproj")
    plane, metres = TangentPlane(*place), scatter(20_000.0)
    degrees = plane.to_degrees(metres)
    proj = pyproj.Proj(proj="ortho", lon_0=place[0], lat_0=place[1], ellps="WGS84")
    np.testing.assert_allclose(np.stack(proj(*degrees.T), axis=1), metres, atol=1e-6)
    np.testing.assert_allclose(plane.to_metres(degrees)[:, :2], metres, atol=1e-6)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("side", "error"), [(400.0, 1e-6), (5000.0, 1e-3), (20_000.0, 0.05)])
def test_distances_are_those_on_the_ellipsoid(place, side, error):
    """Between any two points of a farm of 400 m, 5 km and 20 km: within 0.001 mm, 1 mm and 5 cm of the geodesic."""
    pyproj = pytest.importorskip("pyproj")
    metres = scatter(side)
    degrees = TangentPlane(*place).to_degrees(metres)
    geodesic = pyproj.Geod(ellps="WGS84").inv(*degrees[:-1].T, *degrees[1:].T)[2]
    np.testing.assert_allclose(np.linalg.norm(np.diff(metres, axis=0), axis=1), geodesic, atol=error)


def test_north_is_up_and_east_is_right():
    """A minute of latitude is about 1852 m to the north, one of longitude less by the cosine of the latitude."""
    east, north = TangentPlane(10.0, 60.0).to_metres(np.array([[10.0 + 1 / 60, 60.0], [10.0, 60.0 + 1 / 60]]))
    assert east[:2] == pytest.approx([930.0, 0.1], abs=1.0)
    assert north[:2] == pytest.approx([0.0, 1857.0], abs=1.0)
