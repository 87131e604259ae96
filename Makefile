# `make demo`, `make demo-fleet` and `make test` set everything up by themselves, on a machine with git, make and Python ≥ 3.11.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
comma := ,
# A sourced ROS brings its own rclpy on PYTHONPATH; elsewhere ROS 2 Jazzy comes as wheels.
ROS_EXTRAS := $(if $(ROS_DISTRO),,$(if $(filter x86_64,$(shell uname -m)),ros$(comma)ros-test$(comma)))
EXTRAS := $(ROS_EXTRAS)zenoh$(comma)metrics$(comma)look$(comma)dev

# Children by the hundred start sooner with bytecode.
unexport PYTHONDONTWRITEBYTECODE

# Nothing that runs from here leaves this machine.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export OTHER_PYTHON

.PHONY: dist deb demo demo-fleet test test-all test-kilted on-kilted test-quick test-wire test-pure test-simulation quick-lint lint bench soak fuzz lock screenshots man texts clean system

demo: $(STAMP)
	$(BIN)/rsb-console demo

demo-fleet: $(STAMP)
	$(BIN)/rsb-console demo --fleet

# The tests by folder, or by several that are short, since each start of pytest takes a second. Most wait for most of their
# time, so MANY are run at once: eight on one core, twelve on more. The longest come first, and the largest are run in
# shares (K of N takes every N-th file); what only computes gives way. What runs at once shares no ROS domain, port or file.
#   make test        lint and all tests but those that make test-all adds
#   make test-all    these, tests that are marked as long, simulated networks (tests/network), and a machine with the real
#                    kernel's Bluetooth (tests/bluetooth, tests/README.md)
#   make test-release wheel, source distribution and Debian package, installed into bare environments (part of test-all)
#   make test-kilted what touches ROS, on ROS 2 Kilted, and bridges between Kilted and Jazzy
#   make test-quick  lint without mypy, and what is tested without ROS, processes and screens
#   make test-link   one folder, long tests included
MANY := $(shell $(PYTHON) -c 'import os; print(min(8 * len(os.sched_getaffinity(0)), 12))')
LONGEST := engine.1 engine.2 engine.3 engine.4 engine.5 engine.6 engine.7 engine.8 engine.9 engine.10 \
  console.1 console.2 console.3 console.4 console.5 calls.1 calls.2 calls.3 link.1 link.2 link.3 system.1 system.2 system.3 control bench \
  command.1 command.2
PURE := cdr channel config fleet fuzz history model route
QUICK := $(PURE) wire
COMPUTING := lint test-simulation test-wire test-pure
ALONE := network bluetooth release
ON_KILTED := $(filter engine.% calls.% system.%,$(LONGEST)) ros distributions
FOLDERS := $(sort $(patsubst tests/%/,%,$(dir $(wildcard tests/*/test_*.py))))
REST := $(filter-out $(sort $(basename $(LONGEST))) simulation wire $(PURE) $(ALONE) distributions,$(FOLDERS))
AT_ONCE := $(MAKE) --no-print-directory --keep-going --output-sync=target --jobs

# The same run every time: `make test` draws no examples, seeds or orders of sets at random (--random does).
test: export PYTHONHASHSEED := 0
test: $(STAMP) system
	$(AT_ONCE)=$(MANY) ONLY="-m 'not long'" $(COMPUTING) $(addprefix test-,$(LONGEST) $(REST))

test-all: $(STAMP) system
	$(AT_ONCE)=$(MANY) DRAWN=--random $(COMPUTING) $(addprefix test-,$(LONGEST) $(REST) $(ALONE))

test-kilted: $(STAMP) system
	$(MAKE) --no-print-directory VENV=.venv-kilted ROS_EXTRAS=ros-kilted$(comma)ros-kilted-test$(comma) \
	  OTHER_PYTHON=$(abspath $(BIN))/python on-kilted

on-kilted: $(STAMP)
	$(AT_ONCE)=$(MANY) ONLY="-m 'not long'" $(addprefix test-,$(ON_KILTED))

test-quick: $(STAMP)
	$(AT_ONCE)=3 quick-lint quick.1 quick.2

# What only computes gives way to what talks by DDS: where that starves, one participant of a process may discover another
# without being discovered by it, for good (seen once in 700 starts on a core shared by eight).
GIVES_WAY := nice -n 5
PYTEST = timeout -k 5 1800 $(BIN)/python -m pytest -p no:cacheprovider $(DRAWN)
ONLY :=
DRAWN :=

# Coverage wants all of Hypothesis's examples.
test-wire: $(STAMP)
	$(GIVES_WAY) $(PYTEST) -p no:textual-snapshot tests/wire --cov=rsb_bridge.wire --cov-branch --cov-fail-under=100

test-pure: $(STAMP)
	$(GIVES_WAY) $(PYTEST) -p no:textual-snapshot $(ONLY) $(addprefix tests/,$(PURE))

test-simulation: $(STAMP)
	$(GIVES_WAY) $(PYTEST) -p no:textual-snapshot $(ONLY) tests/simulation

test-%: $(STAMP) system
	$(if $(filter bluetooth,$*),$(GIVES_WAY)) $(PYTEST) $(if $(filter console,$(basename $*)),,-p no:textual-snapshot) \
	  $(ONLY) tests/$(basename $*) $(addprefix --share=,$(addsuffix /$(words $(filter $(basename $*).%,$(LONGEST))),$(subst .,,$(suffix $*))))

quick.%: $(STAMP)
	$(PYTEST) -q -p no:textual-snapshot -m 'not long' $(addprefix tests/,$(QUICK)) --share=$*/2

quick-lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache

lint: quick-lint
	$(GIVES_WAY) $(BIN)/mypy

bench: $(STAMP)
	$(BIN)/python -m bench.run

# New simulated worlds, and beside them real processes that are killed, cut off and frozen (tests/README.md). It takes
# SECONDS (`make soak SECONDS=7200`), and fails with the reasons in words.
soak: SECONDS ?= 1800
soak: $(STAMP)
	$(BIN)/python -m tests.soak --seconds $(SECONDS)

# Coverage-guided fuzzing of every parser, in SECONDS together (tests/README.md).
fuzz: SECONDS ?= 300
fuzz: $(STAMP)
	$(BIN)/python -m tests.fuzz --seconds $(SECONDS)

# Wheel and source distribution. Two builds of one commit are the same, byte by byte.
RELEASE := build/release
dist:
	[ -x $(RELEASE)/bin/hatchling ] || { $(PYTHON) -m venv $(RELEASE) \
	  && $(RELEASE)/bin/pip install --quiet --disable-pip-version-check --require-hashes -r locks/build.txt; }
	rm -rf dist
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) $(RELEASE)/bin/hatchling build -d dist

# A Debian package of that wheel and its locked dependencies, for the machines whose Python is DEB_PYTHON: 3.12 on Ubuntu
# 24.04 (ROS 2 Jazzy, Kilted), 3.11 on Debian 12, 3.13 on Debian 13.
DEB_PYTHON := 3.12
DEB_ARCHITECTURE := $(if $(filter aarch64,$(shell uname -m)),arm64,amd64)
deb: dist
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) $(RELEASE)/bin/python deb/build.py --python $(DEB_PYTHON) \
	  --architecture $(DEB_ARCHITECTURE) dist/*.whl

# The versions and hashes of all that is installed, for every Python and machine at once (docs/install.md).
LOCK := build/lock
LOCKED_ALONE := $(LOCK)/bin/uv pip compile --quiet --universal --python-version 3.11 --upgrade --generate-hashes --no-annotate \
  --custom-compile-command 'make lock'
LOCKED := $(LOCKED_ALONE) pyproject.toml $(LOCK)/build.in
lock:
	$(PYTHON) -m venv $(LOCK)
	$(LOCK)/bin/pip install --quiet --disable-pip-version-check --require-hashes -r locks/checks.txt
	$(PYTHON) -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"], sep="\n")' > $(LOCK)/build.in
	$(LOCKED_ALONE) $(LOCK)/build.in --output-file locks/build.txt
	$(LOCKED_ALONE) --group checks --output-file locks/checks.txt
	$(LOCKED) --output-file locks/run.txt
	$(LOCKED) --extra zenoh --extra metrics --output-file locks/fleet.txt
	$(LOCKED) --extra ros --extra zenoh --extra metrics --extra look --output-file locks/ros.txt
	$(LOCKED) --extra ros --extra ros-test --extra zenoh --extra metrics --extra look --extra dev --output-file locks/dev.txt

PACKAGES := tmux qemu-system-x86 iproute2 nftables systemd debootstrap

# The tests drive a real terminal, real network namespaces and a machine with Bluetooth, systemd checks the units, and
# dpkg installs the Debian package in a bare system.
system:
	@{ command -v tmux && command -v qemu-system-x86_64 && command -v tc && command -v nft \
	  && command -v systemd-analyze && command -v debootstrap; } >/dev/null \
	  || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get update -qq \
	  && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(PACKAGES) >/dev/null; } \
	  || echo "some tests will be skipped, for want of tools (apt install $(PACKAGES))"

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python >= 3.11 is needed; say which with PYTHON=..."; exit 1; }
	@[ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV)
	@$(PYTHON) .ci/install.py $(BIN)/python '.[$(EXTRAS)]'
	@touch $@

# The pictures of the documentation, from the running demos.
screenshots: $(STAMP)
	$(BIN)/python docs/screenshots.py

# Every text that operators may read, in one file.
texts: $(STAMP)
	$(BIN)/python docs/texts.py

# The man page, from the arguments that the command takes.
man: $(STAMP)
	$(BIN)/python docs/manpage.py

clean:
	rm -rf $(VENV) .venv-kilted build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage
