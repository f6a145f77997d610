"""Experience at rest: the replay buffer and what its rows need."""
