"""A task of one's own: agents that cover landmarks."""
