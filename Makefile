# `make demo`, `make demo-fleet` and `make test` set everything up by themselves, on a machine with git, make and Python ≥ 3.11.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
comma := ,
# A sourced ROS brings its own rclpy on PYTHONPATH; elsewhere ROS 2 Jazzy comes as wheels.
ROS_EXTRAS := $(if $(ROS_DISTRO),,$(if $(filter x86_64,$(shell uname -m)),ros$(comma)ros-test$(comma)))
EXTRAS := $(ROS_EXTRAS)zenoh$(comma)metrics$(comma)dev

# Children by the hundred start sooner with bytecode.
unexport PYTHONDONTWRITEBYTECODE

# Nothing that runs from here leaves this machine.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST

.PHONY: demo demo-fleet test test-wire lint bench soak fuzz lock screenshots man texts clean system

demo: $(STAMP)
	$(BIN)/rsb-console demo

demo-fleet: $(STAMP)
	$(BIN)/rsb-console demo --fleet

# The tests by folder, the longest first. Five folders at a time, since many wait for most of their time, and beside them
# those that only compute, one after another. The largest folders are run in shares. Folders share no ROS domain, port or
# file. `make test-link` runs one of them, `make test-bluetooth` those that boot a machine with the real kernel's Bluetooth
# (docs/bluetooth.md).
COMPUTING := bluetooth simulation lint wire
LONGEST := engine.1 engine.2 engine.3 console.1 console.2 console.3 link calls.1 calls.2 system network command
FOLDERS := $(sort $(patsubst tests/%/,%,$(dir $(wildcard tests/*/test_*.py))))
PARTS := $(addprefix test-,$(LONGEST) $(filter-out $(COMPUTING) $(basename $(LONGEST)),$(FOLDERS)))

test: $(STAMP) system
	$(MAKE) --no-print-directory --keep-going --jobs=6 --output-sync=target computing $(PARTS)

# What only computes gives way to what talks by DDS: where that starves, one participant of a process may discover another
# without being discovered by it, for good (seen once in 700 starts on a core shared by eight).
GIVES_WAY := nice -n 5

.PHONY: computing
computing: $(STAMP) system
	@failed=; for part in $(patsubst test-lint,lint,$(addprefix test-,$(COMPUTING))); do \
	  $(MAKE) --no-print-directory $$part || failed=1; done; [ -z "$$failed" ]

test-wire: $(STAMP)
	$(GIVES_WAY) timeout -k 5 1800 $(BIN)/python -m pytest -p no:cacheprovider tests/wire --cov=rsb_bridge.wire --cov-branch --cov-fail-under=100

test-%: $(STAMP) system
	$(if $(filter bluetooth simulation,$*),$(GIVES_WAY)) timeout -k 5 1800 \
	  $(BIN)/python -m pytest -p no:cacheprovider tests/$(basename $*) $(addprefix --share=,$(addsuffix /$(words $(filter $(basename $*).%,$(LONGEST))),$(subst .,,$(suffix $*))))

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(GIVES_WAY) $(BIN)/mypy
	$(GIVES_WAY) $(BIN)/lint-imports --no-cache

bench: $(STAMP)
	$(BIN)/python -m bench.run

# New simulated worlds, and beside them real processes that are killed, cut off and frozen (docs/testing.md). It takes
# SECONDS (`make soak SECONDS=7200`), and fails with the reasons in words.
soak: SECONDS ?= 1800
soak: $(STAMP)
	$(BIN)/python -m tests.soak --seconds $(SECONDS)

# Coverage-guided fuzzing of every parser, in SECONDS together (docs/testing.md).
fuzz: SECONDS ?= 300
fuzz: $(STAMP)
	$(BIN)/python -m tests.fuzz --seconds $(SECONDS)

# The versions and hashes of all that is installed, for every Python and machine at once (docs/install.md).
LOCK := build/lock
LOCKED := $(LOCK)/bin/uv pip compile --quiet --universal --python-version 3.11 --upgrade --generate-hashes --no-annotate \
  --custom-compile-command 'make lock' pyproject.toml $(LOCK)/build.in
lock:
	$(PYTHON) -m venv $(LOCK)
	$(LOCK)/bin/pip install --quiet --disable-pip-version-check uv
	$(PYTHON) -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"], sep="\n")' > $(LOCK)/build.in
	$(LOCKED) --output-file locks/run.txt
	$(LOCKED) --extra zenoh --extra metrics --output-file locks/fleet.txt
	$(LOCKED) --extra ros --extra zenoh --extra metrics --output-file locks/ros.txt
	$(LOCKED) --extra ros --extra ros-test --extra zenoh --extra metrics --extra dev --output-file locks/dev.txt

PACKAGES := tmux qemu-system-x86 iproute2 nftables systemd

# The tests drive a real terminal, real network namespaces and a machine with Bluetooth, and systemd checks the units.
system:
	@{ command -v tmux && command -v qemu-system-x86_64 && command -v tc && command -v nft \
	  && command -v systemd-analyze; } >/dev/null \
	  || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get update -qq \
	  && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(PACKAGES) >/dev/null; } \
	  || echo "some tests will be skipped, for want of tools (apt install $(PACKAGES))"

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python >= 3.11 is needed; say which with PYTHON=..."; exit 1; }
	@[ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[$(EXTRAS)]'
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
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage
