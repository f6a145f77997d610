"""The compiled simulator, one module per subject. Use it only through `eia_sec.rollout.sim.batch`."""
