"""Commands that use a trained policy or a farm."""
