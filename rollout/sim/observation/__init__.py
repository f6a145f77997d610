"""What UAVs observe."""
