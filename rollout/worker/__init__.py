"""The worker process: collects experience, delivers chunks, evaluates on request, and lets people watch."""
