"""Which relay serves which UAV: the Hungarian assignment and its repair by exchanges."""
