"""Policies that fly vehicles: poses and reports in, set-points out, over the bus that training uses."""
