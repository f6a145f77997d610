"""Commands that start the processes of a training run."""
