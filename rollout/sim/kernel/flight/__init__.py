"""Flight: motion, energy, the border, the nearest UAVs, and UAVs that fail."""
