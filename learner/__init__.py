"""The learner: experience in, updates, parameters out. `registry` lists the algorithms."""
