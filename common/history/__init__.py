"""A process's own account of chunks: lines in a file, and totals that replace old lines."""
