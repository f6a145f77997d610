"""A module that parses arguments when it is imported, as scripts do."""

import argparse

parser = argparse.ArgumentParser()
parser.add_argument("--level", required=True)
arguments = parser.parse_args()
