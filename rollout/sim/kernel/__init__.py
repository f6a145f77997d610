"""The compiled simulator, one module for each subject; `rollout.sim.batch` is its only entrance."""
