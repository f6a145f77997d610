"""The learner process: its loop, what it answers, publishes and reports."""
