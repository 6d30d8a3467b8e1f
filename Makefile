# Everything runs in .venv, created by `make env`. See README.md.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# Two stages of one environment: what the daemon, the demo and the benchmarks need, and what only tests and checks need.
RIG    := $(VENV)/.rig
DEV    := $(VENV)/.dev
# One more than there are processors: some of the tests' time is waiting, for emulated devices, time-outs or systemd (three,
# four and five workers took 643, 678 and 759 s on two processors). Each has one thread of numba: threads of loops of
# microseconds that wait for each other on busy processors take twice the time.
WORKERS ?= $(shell expr $$(nproc) + 1)
INSTALL_PACKAGES := $(BIN)/python tools/install_packages.py --editable
# Environment of the programs that `make bench` compares with.
PEERS  := .bench-venv
# Environment of Open3D, which reads exported files in `make test-all`: its thread library is not that of numba.
OPEN3D := .open3d-venv

# Also where the caller forbids it: without compiled modules every process of ours, and every test, starts by compiling.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help env demo test packages kernels pytest test-all audit bench bench-calibration soak check golden protocol screenshot rig-in-a-box box-soak box-latency vm release install uninstall bench-modes load bench-latency campaign bench-service docs docs-figures clean
.DEFAULT_GOAL := help

help:
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 20

env: $(RIG)  ## the environment only: .venv with what the daemon and the demo need

$(RIG): pyproject.toml distributions/rig/pyproject.toml constraints.txt tools/system-packages tools/install_packages.py
	tools/system-packages python
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL_PACKAGES) . --editable './distributions/rig[view]'
	@touch $@

$(DEV): $(RIG)
	$(INSTALL_PACKAGES) '.[dev,docs]' --editable './distributions/rig[view,cluster]'
	@touch $@

demo: $(RIG)  ## measure a moving object on the simulated rig, live; prints the viewer's address
	$(BIN)/fringed demo

test:  ## all checks: style, types, layers, tests but the long ones; twelve minutes on two cores
	tools/system-packages python
	$(MAKE) --no-print-directory --jobs 3 $(DEV) packages kernels
	$(MAKE) --no-print-directory --jobs 2 check pytest
	$(BIN)/python -m pytest -m 'threads and not long' tests/pipeline

# Beside the environment: that mostly waits for the network and the disk.
packages:
	tools/system-packages browser x11 compiler systemd

kernels: $(RIG)
	$(BIN)/python -m tests.kernels

# Beside `check`, whose longest part, mypy, has one thread. Files with slow tests go first (tests/conftest.py), which
# pytest-xdist would reorder by their numbers of tests.
pytest: $(DEV)
	NUMBA_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadgroup --no-loadscope-reorder \
		-m 'not long and not threads'

test-all: test $(OPEN3D)/.complete  ## `make test`, then the long tests (full size, many repeats, virtual machine), each with its time
	tools/system-packages vm pcl
	$(BIN)/python -m pytest -m long --verbose

check: $(DEV)  ## style, types, layers and language only
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tools.language

audit: $(RIG)  ## known vulnerabilities of the pinned dependencies; NOT AUDITED without a source of advisories
	$(BIN)/python tools/audit.py

bench: $(RIG) $(PEERS)/.complete  ## speed, scaling, accuracy, comparison with other programs; options in BENCH="--quick"
	$(BIN)/python -m benchmarks.bench $(BENCH)

$(PEERS)/.complete: benchmarks/peers.txt
	test -x $(PEERS)/bin/python || $(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --requirement benchmarks/peers.txt
	@touch $@

$(OPEN3D)/.complete: constraints.txt | $(RIG)
	test -x $(OPEN3D)/bin/python || $(PYTHON) -m venv $(OPEN3D)
	$(OPEN3D)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt open3d-cpu
	@touch $@

bench-calibration: $(RIG)  ## calibration from rendered images against the ground truth; a quarter of an hour
	$(BIN)/python -m benchmarks.calibration.accuracy
	$(BIN)/python -m benchmarks.calibration.calibrated --scale 0.5

bench-modes: $(RIG)  ## multi-frame modes against the single shot and the ground truth, at rest and in motion; ten minutes
	$(BIN)/python -m benchmarks.accuracy.modes

soak: $(RIG)  ## half an hour at 30 pairs a second: losses, memory, latencies; exit code 1 if a pair is lost
	$(BIN)/python -m benchmarks.soak $(SOAK)

box-soak: $(RIG)  ## 200,000 triggers through the real drivers on emulated hardware, with random faults; ten minutes
	tools/system-packages x11 compiler
	$(BIN)/python -m benchmarks.system.box_soak --triggers 200000 --verbose $(BOX)

box-latency: $(RIG)  ## latency from the trigger's edge to frame, pair, cloud and subscriber on emulated hardware
	tools/system-packages x11 compiler
	$(BIN)/python -m benchmarks.system.box_latency $(BOX)

load: $(RIG)  ## measurement with many subscribers against the same without; five minutes
	$(BIN)/python -m benchmarks.load $(LOAD)

bench-latency: $(RIG)  ## latency from the trigger to a subscriber's process, alone and under load, by rate and size; twenty minutes
	$(BIN)/python -m benchmarks.latency $(LATENCY)

campaign: $(RIG)  ## five hundred random faults in a whole rig on emulated hardware; needs root; a quarter of an hour
	tools/system-packages x11 compiler
	$(BIN)/python -m benchmarks.campaign --verbose $(CAMPAIGN)

bench-service: $(DEV)  ## recovery times of the service under a real systemd, in a container; needs root; two minutes
	tools/system-packages systemd
	$(BIN)/python -m benchmarks.system.service $(SERVICE)

golden: $(RIG)  ## regenerate the golden take of tests/golden (only when its contents must change)
	$(BIN)/python -m tests.golden.make

protocol: $(RIG)  ## regenerate docs/reference/protocol.md and the JSON Schemas of the protocol from the code
	$(BIN)/python -m tools.protocol_reference

docs: $(DEV)  ## the documentation site in out/site; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

docs-figures: $(DEV)  ## the figures of the documentation and the image of README.md, from simulated measurements
	$(BIN)/python -m tools.docs.figures

screenshot: $(DEV)  ## an image of the viewer, from a running `make demo`
	tools/system-packages browser
	$(BIN)/fringed view --screenshot out/demo.png

rig-in-a-box: $(RIG)  ## the real drivers on emulated hardware: projector window, light, cameras, daemon; Ctrl-C ends it
	tools/system-packages x11 compiler
	$(BIN)/python -m sim.box $(BOX)

vm: $(RIG)  ## virtual machine with a real kernel for the V4L2 driver; cached, half a minute the first time
	tools/system-packages vm
	PYTHON=$(BIN)/python tools/vm/build

release: check  ## checks, wheels of both distributions with compiled kernels and checksums in dist/, and their installation; ten minutes
	$(BIN)/python -m tools.release $(RELEASE)

install: $(RIG)  ## install the daemon on this machine as a systemd service; options in INSTALL="--rig rig.yaml"
	$(BIN)/fringed install $(INSTALL)

uninstall: $(RIG)  ## uninstall the service; configuration and takes stay
	$(BIN)/fringed uninstall $(UNINSTALL)

clean:  ## remove the environment and all generated files
	rm -rf $(VENV) $(PEERS) .audit-venv dist out .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
