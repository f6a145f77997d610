"""The farm simulator: the compiled kernel, the batch that drives it, and the NumPy reference."""
