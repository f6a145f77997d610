"""A run on many hosts: its description, what follows from it for each host, and the two ends of an SSH connection."""
