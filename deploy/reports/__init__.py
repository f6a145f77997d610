"""Plots, tables, films and provenance of runs."""
