"""Several learner processes that update the same networks."""
