"""Generators of the documentation: pages, blocks and pictures that come from code and committed results."""
