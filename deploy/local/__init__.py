"""A run on one machine: child processes, compute threads, memory and the run directory."""
