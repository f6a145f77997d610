"""Checkpoints: their contents and format, the thread that writes them, and resuming from them."""
