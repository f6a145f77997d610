"""The compiled simulator, one module per subject. Use it only through `rollout.sim.batch`."""
