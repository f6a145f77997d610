"""The paper's studies, one after another reproducible by one command each: `python -m research.studies STUDY`."""
