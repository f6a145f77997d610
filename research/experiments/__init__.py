"""Questions asked once of policies and farms, each a module with its command, and what they share."""
