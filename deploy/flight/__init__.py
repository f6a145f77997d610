"""Trained actors that fly vehicles: observations in, velocity set-points out, over the same bus as the training."""
