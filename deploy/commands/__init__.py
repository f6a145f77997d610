"""One module for each subcommand of `eia-sec`; each has a `command(arguments)` that returns an exit code."""
