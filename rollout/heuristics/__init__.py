"""Policies that learn nothing, for comparison with trained ones; `registry` lists them by name."""
