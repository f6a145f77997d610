"""The paper's studies and our own, one command each; each writes its data, figure and provenance."""
