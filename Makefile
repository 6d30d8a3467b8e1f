# Everything runs in .venv; `make env` makes it. See README.md.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.complete
# What `make bench` compares with stands in an environment of its own.
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

test: $(STAMP)  ## everything that proves it: style, types, layers, all tests
	tools/system-packages browser x11 compiler vm systemd
	$(MAKE) --no-print-directory check
	$(BIN)/python -m pytest

check: $(STAMP)  ## style, types and layers only
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

audit: $(STAMP)  ## known vulnerabilities of the pinned dependencies; says NOT AUDITED where nobody can be asked
	$(BIN)/python tools/audit.py

bench: $(STAMP) $(PEERS)/.complete  ## speed, scale, accuracy, and other programs beside ours; options in BENCH="--quick"
	$(BIN)/python -m benchmarks.bench $(BENCH)

$(PEERS)/.complete: benchmarks/peers.txt
	test -x $(PEERS)/bin/python || $(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --requirement benchmarks/peers.txt
	@touch $@

bench-calibration: $(STAMP)  ## calibrated from rendered images alone, against the truth; a quarter of an hour
	$(BIN)/python -m benchmarks.calibration
	$(BIN)/python -m benchmarks.calibrated --scale 0.5

bench-modes: $(STAMP)  ## sets of images against the single shot and the truth, at rest and in motion; ten minutes
	$(BIN)/python -m benchmarks.modes

soak: $(STAMP)  ## half an hour at 30 pairs a second: losses, memory, latencies; exit code 1 if one is lost
	$(BIN)/python -m benchmarks.soak $(SOAK)

box-soak: $(STAMP)  ## 200,000 triggers through the real drivers on emulated hardware, with random faults; ten minutes
	tools/system-packages x11 compiler
	$(BIN)/python -m benchmarks.box_soak --triggers 200000 --verbose $(BOX)

box-latency: $(STAMP)  ## from the trigger's edge to frame, pair, cloud and subscriber on emulated hardware
	tools/system-packages x11 compiler
	$(BIN)/python -m benchmarks.box_latency $(BOX)

load: $(STAMP)  ## the measurement under many subscribers against the same without; five minutes
	$(BIN)/python -m benchmarks.load $(LOAD)

campaign: $(STAMP)  ## five hundred random faults against a whole rig on emulated hardware; needs root; a quarter of an hour
	tools/system-packages x11 compiler
	$(BIN)/python -m benchmarks.campaign --verbose $(CAMPAIGN)

bench-service: $(STAMP)  ## the service under a real systemd, in a container: start, killed, frozen; as root, two minutes
	tools/system-packages systemd
	$(BIN)/python -m benchmarks.service $(SERVICE)

golden: $(STAMP)  ## make the golden take of tests/golden anew (only when its contents must change)
	$(BIN)/python -m tests.golden.make

screenshot: $(STAMP)  ## the image in this README, of a running `make demo`
	tools/system-packages browser
	$(BIN)/fringed view --screenshot docs/images/demo.png

rig-in-a-box: $(STAMP)  ## the real drivers on emulated hardware: projector window, light, cameras, daemon; Ctrl-C ends
	tools/system-packages x11 compiler
	$(BIN)/python -m sim.box $(BOX)

vm: $(STAMP)  ## the virtual machine in which the V4L2 driver meets a real kernel; cached, half a minute the first time
	tools/system-packages vm
	PYTHON=$(BIN)/python tools/vm/build

install: $(STAMP)  ## put the daemon onto this machine as a systemd service; options in INSTALL="--rig rig.yaml"
	$(BIN)/fringed install $(INSTALL)

uninstall: $(STAMP)  ## take the service away; configuration and takes stay
	$(BIN)/fringed uninstall $(UNINSTALL)

clean:  ## remove the environment and everything made
	rm -rf $(VENV) $(PEERS) .audit-venv dist out .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
