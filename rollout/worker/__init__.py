"""The worker process: collects experience, sends chunks, and shows its farm to those who watch."""
