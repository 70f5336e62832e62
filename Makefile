# `make demo` and `make test` set up .venv by themselves; the second run finds it ready.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ARGS ?=

# The last line of what sets up .venv, unless the shell has it on its path.
NEXT = @[ "$$VIRTUAL_ENV" = "$(abspath $(VENV))" ] || \
  echo "For mmc-gym and the other commands of the README type:  . $(VENV)/bin/activate"

# A stamp is touched only after its step succeeded, so an interrupted step is done again.
VENV_READY := $(VENV)/.stamp-venv
PACKAGE_READY := $(VENV)/.stamp-package
DEV_READY := $(VENV)/.stamp-dev
DOCS_READY := $(VENV)/.stamp-docs
BENCHMARK_READY := $(VENV)/.stamp-benchmark

# The constraints hold for isolated builds too: pip before 25.3 takes them from PIP_CONSTRAINT,
# later ones from PIP_BUILD_CONSTRAINT.
export PIP_CONSTRAINT := constraints.txt
export PIP_BUILD_CONSTRAINT := constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_NO_INPUT := 1
PIP_INSTALL = $(BIN)/python -m pip install --quiet -c constraints.txt

.DEFAULT_GOAL := help
.PHONY: help demo test test-all test-processors lint type imports format packages docs paper speed clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-15s %s\n", $$1, $$2 }' Makefile

demo: $(PACKAGE_READY) ## install mmc-gym into .venv and compare the shipped policies
	$(BIN)/mmc-gym compare $(ARGS)
	$(NEXT)

test: lint type imports ## install the dev extra into .venv, then lint, types, import rules, quick tests
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow" $(ARGS)
	$(NEXT)

test-all: $(DEV_READY) ## what `make test` leaves out: site, browser, Ray, studies, whole trainings
	$(BIN)/python -m pytest -n auto --dist worksteal -m slow $(ARGS)
	$(NEXT)

# Processors without AVX-512 take OpenBLAS's kernels for Haswell, and numba's code for a generic one
# has no AVX at all.  No test compares the two with each other, so one run does for both.  Nor does
# a result depend on the number of threads.
test-processors: export OPENBLAS_CORETYPE = Haswell
test-processors: export NUMBA_CPU_NAME = generic
test-processors: export OPENBLAS_NUM_THREADS = 2
test-processors: $(DEV_READY) ## the quick tests of network, agents and body as on other processors
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow" $(ARGS) \
	  tests/network tests/agents tests/body

lint: $(DEV_READY) ## ruff: rules and format
	$(BIN)/ruff check
	$(BIN)/ruff format --check

type: $(DEV_READY) ## mypy --strict on mmc_gym
	$(BIN)/mypy

imports: $(DEV_READY) ## the import rules between the packages
	$(BIN)/lint-imports --no-logo

format: $(DEV_READY) ## let ruff repair and format everything
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

packages: $(VENV_READY) ## build wheel and source archive, try each in an empty environment
	$(BIN)/python .ci/packages.py $(ARGS)

docs: $(DOCS_READY) ## build the site into build/site (2 minutes, later seconds; all films: ARGS="-D films=all")
	$(BIN)/python -m sphinx -n -W --keep-going $(ARGS) docs build/site

paper: $(PACKAGE_READY) ## run the paper's experiments: figures, data, published beside measured
	$(BIN)/python -m studies.paper $(ARGS)

speed: $(BENCHMARK_READY) ## install the peers' packages, time environments, network and agents beside them
	$(BIN)/python benchmarks/speed.py $(ARGS)

clean: ## remove .venv, build outputs and caches
	rm -rf $(VENV) build dist .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	rm -rf docs/_generated docs/envs docs/examples docs/sg_execution_times.rst
	find mmc_gym studies tests examples benchmarks docs -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV_READY):
	@command -v "$(PYTHON)" >/dev/null 2>&1 || { \
	  echo "mmc-gym needs Python 3.11 or newer, but '$(PYTHON)' was not found." \
	       "Name one with: make PYTHON=/path/to/python3 ..." >&2; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "mmc-gym needs Python 3.11 or newer, but '$(PYTHON)' is `"$(PYTHON)" --version 2>&1`." \
	       "Name another with: make PYTHON=python3.12 ..." >&2; exit 1; }
	@"$(PYTHON)" -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo "'$(PYTHON)' cannot make virtual environments: its venv or ensurepip module is missing." \
	       "On Debian and Ubuntu: apt install python3-venv" >&2; exit 1; }
	@echo "Making $(VENV) with `"$(PYTHON)" --version 2>&1`"
	@"$(PYTHON)" -m venv $(VENV) && $(BIN)/python -m pip --version >/dev/null 2>&1 \
	  || "$(PYTHON)" -m venv --clear $(VENV)
	@$(PIP_INSTALL) 'pip>=22'
	@touch $@

$(PACKAGE_READY): $(VENV_READY) pyproject.toml constraints.txt
	@echo "Installing mmc-gym (PyTorch is large: the first time can take minutes)"
	@$(PIP_INSTALL) -e '.[fast]'
	@touch $@

$(DEV_READY): $(PACKAGE_READY)
	@echo "Installing what the tests need"
	@$(PIP_INSTALL) -e '.[dev]'
	@touch $@

$(DOCS_READY): $(PACKAGE_READY)
	@echo "Installing what the site is built with"
	@$(PIP_INSTALL) -e '.[docs]'
	@touch $@

$(BENCHMARK_READY): $(PACKAGE_READY)
	@echo "Installing the environments to compare with"
	@$(PIP_INSTALL) -e '.[fast,benchmark]'
	@touch $@
