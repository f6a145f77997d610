"""Time to a fixed reward by the number of workers, where a step takes real time; and the farm on the same cores."""
