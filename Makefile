# `make train` and `make test` need Python 3.11 and nothing else: they set up .venv themselves.
# No target names a path from outside, so the checkout may lie anywhere, spaces included.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.PHONY: help setup train test test-fast test-all reliability lint docs benchmark clean

PYTHON ?= python3.11
VENV := .venv
INSTALLED := $(VENV)/.installed
RUN := $(VENV)/bin/python -m

help:
	@echo "make train       set up, train robots for any house, and evaluate them"
	@echo "make test        set up, run the tests, but those that take long"
	@echo "make test-fast   set up, run the quick tests, a few cases of each family"
	@echo "make test-all    set up, run all tests"
	@echo "make reliability set up, kill, damage and deceive it for hours"
	@echo "make lint        set up, check format and types"
	@echo "make docs        set up, build the pages into site/"
	@echo "make benchmark   set up, measure speed"
	@echo "make clean       remove .venv and caches; runs/ stays"

setup: $(INSTALLED)

# Renewed only when what is to be installed has changed.
$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(RUN) pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	touch $@

# One thread: as fast here as two, and, where the CPU has bfloat16, it ends with
# the weights that the README's table is of.
train: $(INSTALLED)
	OMP_NUM_THREADS=1 $(RUN) marl_clean train +experiment=any_house

# Some environments forbid Python to write compiled modules; then each worker, and each process that
# a test starts, would compile the package and the rewritten tests anew.
PYTEST := OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(RUN) pytest -n 2 --dist worksteal

test: $(INSTALLED)
	$(PYTEST) -m "not long"

test-fast: $(INSTALLED)
	$(PYTEST) -m "not slow and not long"

test-all: $(INSTALLED)
	$(PYTEST)

# The long forms of what the tests do a few times; docs/reliability.md has their last figures.
HARNESS := OMP_NUM_THREADS=1 $(RUN) tests.reliability
reliability: $(INSTALLED)
	$(HARNESS).kills --trials 1000
	$(HARNESS).crash_points
	$(HARNESS).full_disk --trials 200
	$(HARNESS).damage --trials 100
	$(HARNESS).mutations --trials 20000
	$(HARNESS).numbers --trials 1914
	$(HARNESS).settings --trials 3600 --by-hand
	$(HARNESS).signals --trials 200 --starts 40
	$(HARNESS).at_once --trials 10
	$(HARNESS).determinism --steps 10000
	$(HARNESS).pages
	$(HARNESS).simulator --steps 1000000
	$(HARNESS).soak --seconds 1800
	$(HARNESS).sweeps basic joblib

$(VENV)/.installed-dev: $(INSTALLED)
	$(RUN) pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

lint: $(VENV)/.installed-dev
	$(RUN) ruff check .
	$(RUN) ruff format --check .
	$(RUN) mypy

$(VENV)/.installed-docs: $(INSTALLED)
	$(RUN) pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	touch $@

docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(RUN) mkdocs build --quiet --strict

$(VENV)/.installed-benchmark: $(INSTALLED)
	$(RUN) pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[benchmark]'
	touch $@

benchmark: $(VENV)/.installed-benchmark
	$(RUN) marl_clean benchmark

clean:
	rm -rf $(VENV) .pytest_cache .hypothesis .mypy_cache .ruff_cache dist build site
