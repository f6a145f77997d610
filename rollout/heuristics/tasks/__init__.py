"""Heuristics for monitoring and data collection UAVs, and what they share."""
