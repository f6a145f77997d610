"""Farms on disk: sensors' places as CSV or GeoJSON, read with every mistake named by its line, and written."""

from rollout.farm_files.files import read_farm, write_farm
from rollout.farm_files.survey import GivenFarm

__all__ = ["GivenFarm", "read_farm", "write_farm"]
