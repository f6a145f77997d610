"""Policies that learn nothing: what every trained policy is compared with. One file each."""
