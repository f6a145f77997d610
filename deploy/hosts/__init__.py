"""A run on several hosts: the fleet file, the processes that follow from it, and both ends of the SSH connection."""
