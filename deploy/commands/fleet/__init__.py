"""Commands for runs on many hosts."""
