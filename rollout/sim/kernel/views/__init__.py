"""Observations that a configuration may add, one module each; `added` puts them together in their order."""
