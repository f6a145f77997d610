"""Commands for runs on several hosts."""
