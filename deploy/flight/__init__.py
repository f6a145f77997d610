"""Trained actors that fly vehicles: observations in, velocity set-points out, over the bus that training uses."""
