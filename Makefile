# `make run` computes the embedded example, `make test` runs every test. Both set up .venv by themselves.
.PHONY: run test setup lint check lab clean

PYTHON ?= python3
UV := .venv/uv/bin/uv
BIN := .venv/bin

run: setup
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/dvc repro
	$(BIN)/workbench where

test: setup
	$(BIN)/python -m pytest

setup: .venv/.ready

# uv installs exactly what uv.lock names; it lives in a corner of .venv so that nothing else is touched.
.venv/.ready: pyproject.toml uv.lock
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 13))' || \
	  { echo "Python 3.11 or 3.12 is needed; choose one with: make PYTHON=python3.11 ..."; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	test -x $(UV) || { $(PYTHON) -m venv .venv/uv && .venv/uv/bin/pip install --quiet uv; }
	VIRTUAL_ENV="$(CURDIR)/.venv" $(UV) sync --locked --quiet --python $(BIN)/python --no-managed-python
	touch $@

lint: setup
	$(BIN)/ruff format --check . && $(BIN)/ruff check . && $(BIN)/mypy

lab: setup
	$(BIN)/jupyter lab notebooks

clean:
	rm -rf .venv
