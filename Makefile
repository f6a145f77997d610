# make train   set up, then train EIA-SEC on this machine:  make train ARGS="--preset quick --workers 1"
# make test    set up, then what a contributor runs before a change:  make test ARGS="tests/common -x"
# make check   set up, then the other tests: processes, faults, browsers, wheels, research/
# make nightly set up, then the faults in full doses: hours
# make lint    set up, then ruff and mypy
# make docs    set up, then refresh the generated blocks and pictures of docs/
# make site    set up, then build the documentation as a site in build/site; a broken link is an error
# make bench-peers  set up, then measure side by side with other projects, each in an environment of its own:
#              make bench-peers ARGS="--write research/results/peers"
# make reproduce  set up, then make the paper's headline table from scratch; says beforehand how long it takes:
#              make reproduce JOBS=4; another study: make reproduce STUDY=ablation
# make clean   remove the environments and all caches (runs/ stays)
#
# PYTHON    the interpreter that .venv is made from (3.11 or newer)
# JOBS      tests, or runs of a study, at a time
# STUDY     what make reproduce does
# PIP_ARGS  added to every pip install, for instance the index of a CPU-only torch

PYTHON ?= python3
PIP_ARGS ?=
JOBS ?= 2
STUDY ?= training
ARGS ?=

VENV := .venv
READY := $(VENV)/.ready
PIP := $(VENV)/bin/python -m pip --disable-pip-version-check --no-color install --progress-bar off -c constraints.txt $(PIP_ARGS)

# What pip is at: on a terminal one line that changes, else the large packages and the end. Warnings and errors stay whole.
PIPE := export PYTHONUNBUFFERED=1; set -o pipefail
define PIP_LINE
while read -r line; do \
  case "$$line" in Collecting*|Processing*|Downloading*|Preparing*|Installing*) ;; *) continue ;; esac; \
  if [ -t 1 ]; then printf '\r\033[K  %.70s' "$$line"; \
  else case "$$line" in *[0-9][0-9][0-9].[0-9]\ MB*|Installing*) printf '  %.100s\n' "$$line" ;; esac; fi; \
done; if [ -t 1 ]; then printf '\r\033[K'; fi
endef

.PHONY: train test check nightly lint docs site bench-peers reproduce setup clean

train: $(READY)
	@$(VENV)/bin/eia-sec train $(ARGS)

PYTEST := OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(VENV)/bin/python -m pytest

test: $(READY)
	@$(PYTEST) -n $(JOBS) --dist worksteal $(ARGS)

check: $(READY)
	@$(PYTEST) -n $(JOBS) --dist worksteal -m "(slow or research) and not nightly" $(ARGS)

nightly: $(READY)
	@$(PYTEST) -m nightly $(ARGS)

lint: $(READY)
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/ruff format --check .
	@$(VENV)/bin/mypy

docs: $(READY)
	@$(VENV)/bin/python -m research.pages.pages

site: $(READY)
	@NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --strict --quiet
	@echo "open build/site/index.html"

bench-peers: $(READY)
	@$(VENV)/bin/python -m research.benchmarks.peers --pip-args="$(PIP_ARGS)" $(ARGS)

reproduce: $(READY)
	@$(VENV)/bin/python -m research.studies $(STUDY) --scale full --jobs $(JOBS) $(ARGS)

setup: $(READY)

# bash, because a pipe must fail where pip does
$(READY): SHELL := bash
$(READY): pyproject.toml constraints.txt
	@command -v "$(PYTHON)" >/dev/null || { \
	  echo "EIA-SEC needs Python 3.11 or newer, and $(PYTHON) was not found; name one with PYTHON=python3.11" >&2; \
	  exit 2; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "EIA-SEC needs Python 3.11 or newer, and $$($(PYTHON) --version) was found;" \
	       "name another with PYTHON=python3.11" >&2; \
	  exit 2; }
	@echo "Setting up $(VENV): a few minutes, only this once."
	@"$(PYTHON)" -m venv $(VENV)
	@$(PIPE); $(PIP) torch==$$(sed -n 's/^torch==//p' constraints.txt) hatchling | { $(PIP_LINE); }
	@$(PIPE); $(PIP) --no-build-isolation --editable '.[dev,export,mavlink,px4,record]' | { $(PIP_LINE); }
	@echo "Compiling the simulator once, so that no process has to: two minutes or more."
	@NUMBA_NUM_THREADS=1 $(VENV)/bin/python -c 'from eia_sec.common.config import FarmConfig; from eia_sec.rollout.sim.batch import FarmBatch; \
	  FarmBatch(FarmConfig(), 1).reset(0, 0, 0)'
	@touch $(READY)

clean:
	rm -rf $(VENV) research/benchmarks/.venvs dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
