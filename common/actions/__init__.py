"""Actions: how they are sampled, and how an actor's output becomes the environment's action."""
