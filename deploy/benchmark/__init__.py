"""Comparisons of algorithms over seeds and environments, see `eia-sec benchmark`."""
