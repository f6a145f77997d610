"""Simulated farms and the worker processes that collect experience in them."""
