# Everything runs in .venv, created by `make env`. See README.md.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.complete
# Environment of the programs that `make bench` compares with.
PEERS  := .bench-venv

.PHONY: help env demo test audit bench bench-calibration soak check golden screenshot rig-in-a-box box-soak box-latency vm install uninstall bench-modes load campaign bench-service clean
.DEFAULT_GOAL := help

help:
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 20

env: $(STAMP)  ## the environment only: .venv with everything

$(STAMP): pyproject.toml constraints.txt tools/system-packages
	tools/system-packages python
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[rig,dev]'
	@touch $@

demo: $(STAMP)  ## measure a moving object on the simulated rig, live; prints the viewer's address
	$(BIN)/fringed demo

test: $(STAMP)  ## all checks: style, types, layers, tests
	tools/system-packages browser x11 compiler vm systemd
	$(MAKE) --no-print-directory check
	$(BIN)/python -m pytest

check: $(STAMP)  ## style, types and layers only
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

audit: $(STAMP)  ## known vulnerabilities of the pinned dependencies; NOT AUDITED without a source of advisories
	$(BIN)/python tools/audit.py

bench: $(STAMP) $(PEERS)/.complete  ## speed, scaling, accuracy, comparison with other programs; options in BENCH="--quick"
	$(BIN)/python -m benchmarks.bench $(BENCH)

$(PEERS)/.complete: benchmarks/peers.txt
	test -x $(PEERS)/bin/python || $(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --requirement benchmarks/peers.txt
	@touch $@

bench-calibration: $(STAMP)  ## calibration from rendered images against the ground truth; a quarter of an hour
	$(BIN)/python -m benchmarks.calibration
	$(BIN)/python -m benchmarks.calibrated --scale 0.5

bench-modes: $(STAMP)  ## multi-frame modes against the single shot and the ground truth, at rest and in motion; ten minutes
	$(BIN)/python -m benchmarks.modes

soak: $(STAMP)  ## half an hour at 30 pairs a second: losses, memory, latencies; exit code 1 if a pair is lost
	$(BIN)/python -m benchmarks.soak $(SOAK)

box-soak: $(STAMP)  ## 200,000 triggers through the real drivers on emulated hardware, with random faults; ten minutes
	tools/system-packages x11 compiler
	$(BIN)/python -m benchmarks.box_soak --triggers 200000 --verbose $(BOX)

box-latency: $(STAMP)  ## latency from the trigger's edge to frame, pair, cloud and subscriber on emulated hardware
	tools/system-packages x11 compiler
	$(BIN)/python -m benchmarks.box_latency $(BOX)

load: $(STAMP)  ## measurement with many subscribers against the same without; five minutes
	$(BIN)/python -m benchmarks.load $(LOAD)

campaign: $(STAMP)  ## five hundred random faults in a whole rig on emulated hardware; needs root; a quarter of an hour
	tools/system-packages x11 compiler
	$(BIN)/python -m benchmarks.campaign --verbose $(CAMPAIGN)

bench-service: $(STAMP)  ## recovery times of the service under a real systemd, in a container; needs root; two minutes
	tools/system-packages systemd
	$(BIN)/python -m benchmarks.service $(SERVICE)

golden: $(STAMP)  ## regenerate the golden take of tests/golden (only when its contents must change)
	$(BIN)/python -m tests.golden.make

screenshot: $(STAMP)  ## the image of README.md, from a running `make demo`
	tools/system-packages browser
	$(BIN)/fringed view --screenshot docs/images/demo.png

rig-in-a-box: $(STAMP)  ## the real drivers on emulated hardware: projector window, light, cameras, daemon; Ctrl-C ends it
	tools/system-packages x11 compiler
	$(BIN)/python -m sim.box $(BOX)

vm: $(STAMP)  ## virtual machine with a real kernel for the V4L2 driver; cached, half a minute the first time
	tools/system-packages vm
	PYTHON=$(BIN)/python tools/vm/build

install: $(STAMP)  ## install the daemon on this machine as a systemd service; options in INSTALL="--rig rig.yaml"
	$(BIN)/fringed install $(INSTALL)

uninstall: $(STAMP)  ## uninstall the service; configuration and takes stay
	$(BIN)/fringed uninstall $(UNINSTALL)

clean:  ## remove the environment and all generated files
	rm -rf $(VENV) $(PEERS) .audit-venv dist out .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
