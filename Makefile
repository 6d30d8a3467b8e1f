# Everything runs in .venv; `make env` makes it. See README.md.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.complete
export PYTHONDONTWRITEBYTECODE :=

.PHONY: env demo test bench check clean
.DEFAULT_GOAL := help

help:
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 20

env: $(STAMP)  ## the environment only: .venv with everything

$(STAMP): pyproject.toml constraints.txt tools/system-packages
	tools/system-packages python
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[rig,dev]'
	@touch $@
