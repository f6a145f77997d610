"""The simulator once more, written from the equations in plain NumPy, for tests."""
