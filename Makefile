# Everything a newcomer needs: `make demo`, `make test`. Every target installs what it needs into .venv first.
PYTHON ?= python3
VENV := .venv
BENCH := .venv-bench
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install -q
JOBS ?= 2

.DEFAULT_GOAL := help
.PHONY: help demo test lint bench docs results clean

help:            ## list the targets
	@grep -E '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/'

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# Installs are editable, so that an edit of the sources needs none; a stamp is older than a changed pyproject.toml.
$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(PIP) -e .
	@touch $@

$(VENV)/.installed-%: pyproject.toml | $(BIN)/python
	$(PIP) -e '.[$*]'
	@touch $@ $(VENV)/.installed

demo: $(VENV)/.installed  ## the main job on the embedded scenario; prints verdicts and the path of the report
	$(BIN)/pntegrity demo

lint: $(VENV)/.installed-test  ## ruff, mypy, import-linter
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: lint  ## lint, then all tests
	$(BIN)/pytest -n $(JOBS)

# An environment of its own: gnss_lib_py wants older versions of what we use.
$(BENCH)/.installed: pyproject.toml
	$(PYTHON) -m venv $(BENCH)
	$(BENCH)/bin/python -m pip --disable-pip-version-check install -q -e '.[bench]'
	@touch $@

bench: $(BENCH)/.installed  ## cost of every stage, beside other tools
	$(BENCH)/bin/pytest benchmarks

docs: $(VENV)/.installed-docs  ## the documentation, in docs/_build/html
	$(BIN)/sphinx-build -q -W --keep-going -b html docs docs/_build/html
	@echo docs/_build/html/index.html

results: $(VENV)/.installed  ## measure every figure of docs/results.md again; DATA=folder of the real logs
	$(BIN)/pntegrity evidence all $(if $(DATA),--data '$(DATA)') --write docs/results.md

clean:           ## remove what the targets made
	rm -rf $(VENV) $(BENCH) docs/_build demo-results build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
