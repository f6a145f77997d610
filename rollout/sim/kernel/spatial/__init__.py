"""Spatial look-ups: nearest sensors and UAVs, and sums over quadrants."""
