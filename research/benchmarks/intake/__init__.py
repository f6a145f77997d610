"""How many environment steps a learner takes in, beside other ways to move them."""
