"""Training from a Python program, on which `eia_sec.train` stands."""
