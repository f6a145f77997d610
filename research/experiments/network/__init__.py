"""Experiments with many hosts, as network namespaces."""
