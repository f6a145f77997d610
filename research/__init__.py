"""What the results come from: studies, experiments and benchmarks, and the pages that show them."""
