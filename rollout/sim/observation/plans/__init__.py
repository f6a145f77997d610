"""Plans of several moves that UAVs with tasks see in their observations."""
