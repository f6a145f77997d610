"""Commands that use a policy or a farm."""
