"""Pictures of a farm: for a window, a terminal, a file or a film."""
