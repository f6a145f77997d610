"""From records to claims: statistics, verdicts and targets."""
