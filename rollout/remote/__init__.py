"""Environments in other processes and on robots: `serve` offers one, and workers step it over Zenoh."""
