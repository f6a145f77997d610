"""`python -m research.studies STUDY`."""

import sys

from eia_sec.deploy.exit_codes import run_command
from research.studies.command import command

sys.exit(run_command(lambda: command(sys.argv[1:])))
