"""The learner: per-agent actors and critics, the shared ensemble critic, replay and checkpoints."""
