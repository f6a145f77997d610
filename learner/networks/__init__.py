"""Stacked networks: many small perceptrons as a few batched matrix products, with their optimiser."""
