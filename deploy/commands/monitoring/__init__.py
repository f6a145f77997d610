"""Commands that observe a run."""
