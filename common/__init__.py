"""What all processes agree on: configuration, team layout, messages, keys, the bus and the errors."""
