"""The elite coordinator: scores the agents, picks each type's elite and publishes imitation events."""
