"""Networks and optimisers of both families."""
