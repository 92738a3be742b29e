# Every target works from a clean clone: the virtual environment is made when it is missing or out of date.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.rm501-dev
DEMO   := $(VENV)/.rm501-demo

.PHONY: demo test lint types unit bench docs model clean help

help:            ## list the targets
	@grep -E '^[a-z]+: .*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "rm501 needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)

$(DEMO): $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[plot]'
	@touch $@

$(STAMP): $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@ $(DEMO)

demo: $(DEMO)    ## home the emulated arm and run the thesis's pick-and-place program
	$(BIN)/rm501-host --config configs/thesis.toml run examples/pick_and_place.ngc --speed max --picture build/pick_and_place.png

test: lint types unit   ## lint, types and tests

lint: $(STAMP)   ## ruff and the import arrows
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(STAMP)  ## mypy, strict
	$(BIN)/mypy

unit: $(STAMP)   ## the tests, on both cores
	$(BIN)/python -m pytest -n 2 --dist loadgroup

bench: $(STAMP)  ## every benchmark at its short setting
	$(BIN)/python -m benchmarks

docs: $(STAMP)   ## renew the parts of docs/ that come from the code, and the figures
	$(BIN)/python -m rm501_protocol.documentation docs/protocol.md
	for script in docs/figures/*.py; do $(BIN)/python $$script || exit 1; done

model:           ## check the Promela model of the link (needs spin and a C compiler)
	sh model/check.sh

clean:           ## remove what the targets made
	rm -rf $(VENV) build .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
