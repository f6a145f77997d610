"""Launching, watching and reporting: the command line and what it starts."""
