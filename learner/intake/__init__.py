"""Experience arriving: the receiver, the ledger that accounts for every step, and limits on misbehaving peers."""
