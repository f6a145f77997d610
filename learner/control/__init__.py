"""The learner on the control lane: parameters out, commands and imitation events in."""
