"""Farms on disk: positions of sensors as CSV or GeoJSON. A mistake in a file is reported with its line."""

from eia_sec.rollout.farm_files.files import read_farm, write_farm
from eia_sec.rollout.farm_files.survey import GivenFarm

__all__ = ["GivenFarm", "read_farm", "write_farm"]
