# Everything a developer does has a name here. Each target sets up what it needs, on a fresh machine too.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
NATIVE := pyproject.toml CMakeLists.txt $(wildcard src/native/*)

.DEFAULT_GOAL := help
.PHONY: help demo test hunt bench docs check clean referees

help:  ## list the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "%-10s %s\n", $$1, $$2}'

$(VENV)/pip.stamp:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	@touch $@

$(VENV)/installed.stamp: $(VENV)/pip.stamp $(NATIVE)
	$(BIN)/python -m pip install --quiet --editable ".[film]"
	@touch $@

$(VENV)/developer.stamp: $(VENV)/installed.stamp
	$(BIN)/python -m pip install --quiet --group dev
	@touch $@

demo: $(VENV)/installed.stamp  ## a person walks: opens the page, leaves files in out/demo
	$(BIN)/vitruvian demo

test: $(VENV)/developer.stamp  ## all tests
	$(BIN)/python -m pytest -n 2

hunt: $(VENV)/developer.stamp  ## property tests with new random cases
	HYPOTHESIS_PROFILE=hunt $(BIN)/python -m pytest $$(grep -l hypothesis tests/test_*.py)

bench: $(VENV)/developer.stamp  ## measure against peers, print ratios
	$(BIN)/vitruvian bench

check: $(VENV)/developer.stamp  ## format, lint and types
	$(BIN)/ruff format --check src tests tools benchmarks examples
	$(BIN)/ruff check src tests tools benchmarks examples
	$(BIN)/mypy

docs: $(VENV)/installed.stamp  ## reference of commands and modules, in out/docs
	$(BIN)/python -m pip install --quiet --group docs
	mkdir -p out/docs
	$(BIN)/python -m typer vitruvian.cli utils docs --name vitruvian --output out/docs/commands.md
	$(BIN)/pdoc --output-directory out/docs vitruvian

referees: .referee/node_modules/.stamp  ## npm packages that tests compare with

.referee/node_modules/.stamp:
	mkdir -p .referee
	cd .referee && npm install --ignore-scripts --no-audit --no-fund --no-save x_ite@15 gltf-validator@2.0.0-dev.3.10 playwright-core@1 three@0.187
	@touch $@

clean:  ## remove everything that was built
	rm -rf $(VENV) build dist out .referee .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find src -name '*.so' -delete
