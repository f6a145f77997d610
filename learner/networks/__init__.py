"""Many small perceptrons, computed as a few batched products or by compiled kernels, and their optimiser."""
