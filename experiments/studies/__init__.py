"""The paper's studies, one after another reproducible by one command each: `eia-sec reproduce STUDY`."""
