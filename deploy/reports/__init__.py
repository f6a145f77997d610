"""What a run leaves behind: plots, tables, films and provenance."""
