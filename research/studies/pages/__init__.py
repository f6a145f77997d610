"""Plots, tables and pages of the studies."""
