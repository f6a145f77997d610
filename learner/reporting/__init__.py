"""What the learner reports: metrics.jsonl, TensorBoard scalars, metric messages and alarms."""
