"""The compiled simulator, one module for each subject; `rollout.farms` is its only entrance."""
