"""Learning on policy: PPO for many agents, with independent, team-wide or ensemble value functions."""
