"""Using a trained policy: evaluation, replay and export."""
