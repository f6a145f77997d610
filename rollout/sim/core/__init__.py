"""The compiled simulator: its arrays and numbers, and the stages of a step."""
