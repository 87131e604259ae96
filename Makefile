# `make demo`, `make demo-fleet` and `make test` set everything up by themselves, on a machine with git, make and Python ≥ 3.11.
# CONTRIBUTING.md says what each target is for, and how long it takes.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
comma := ,
# A sourced ROS brings its own rclpy on PYTHONPATH; elsewhere ROS 2 Jazzy comes as wheels.
ROS_EXTRAS := $(if $(ROS_DISTRO),,$(if $(filter x86_64,$(shell uname -m)),ros$(comma)ros-test$(comma)))
EXTRAS := $(ROS_EXTRAS)zenoh$(comma)metrics$(comma)look$(comma)record$(comma)mcp$(comma)dev

# Children by the hundred start sooner with bytecode, and nothing that runs from here leaves this machine.
unexport PYTHONDONTWRITEBYTECODE
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export OTHER_PYTHON

.PHONY: demo demo-fleet test test-pythons test-all on-all test-kilted on-kilted test-quick test-core on-core coverage test-wire quick-lint types lint soak fuzz \
  bench peers foreign dist deb lock screenshots texts plots man system clean
demo: $(STAMP)
	$(BIN)/rsb-console demo
demo-fleet: $(STAMP)
	$(BIN)/rsb-console demo --fleet

# Most tests wait for most of their time, so there are six workers a core. Sets have one order in all workers, and each day another.
WORKERS := $(shell $(PYTHON) -c 'import os; print(min(6 * len(os.sched_getaffinity(0)), 12))')
PYTEST = env PYTHONHASHSEED=$(SEED) timeout -s INT -k 60 $(LIMIT) $(BIN)/python -m pytest
SEED := 0
# s, for a run that hangs: one core that a busy loop shares takes 1,900.
LIMIT := 7200
# What fails runs once more, alone. `make test NET=` is without that, as all that runs at night is.
NET = $(BIN)/python -P .ci/net.py
# If a worker is lost, its test fails, and what is left is for another run: with a new worker, pytest-xdist 3.8 hangs at the end.
AT_ONCE = $(PYTEST) -n $(WORKERS) --dist loadscope --max-worker-restart 0
# tests/checks runs lint, and tests/wire with its coverage.
FEATURES := $(wildcard extras/rsb_extras/*/tests)
ALL := tests $(FEATURES)
without = $(addprefix --ignore=tests/,distributions $(1))
QUICK := cdr channel config fuzz model route wire
# What shows that the core alone is a whole bridge: some minutes less than all of its tests.
CORE := $(QUICK) feature link control/test_protocol.py control/test_operator_sessions.py command/test_command.py \
  $(addprefix engine/test_,operations.py arming.py actions.py reloading.py restarting.py) console/test_main_screen.py

test: $(STAMP) system
	$(NET) $(AT_ONCE) -m "not long" $(ALL) $(call without,wire network bluetooth release)
# `make test` on each Python from 3.11 to 3.14 that is on PATH or of pyenv, each in an environment of its own.
test-pythons: system
	@$(PYTHON) -P .ci/pythons.py
test-all: $(STAMP) system
	$(MAKE) SEED=$$(date +%-j) LIMIT=20000 on-all
on-all:
	$(AT_ONCE) --random $(ALL) $(call without,wire)
test-kilted: $(STAMP) system
	$(MAKE) VENV=.venv-kilted ROS_EXTRAS=ros-kilted$(comma)ros-kilted-test$(comma) OTHER_PYTHON=$(abspath $(BIN))/python on-kilted
on-kilted: $(STAMP)
	$(AT_ONCE) -m "not long" $(addprefix tests/,engine calls system ros distributions)
test-quick: $(STAMP)
	$(PYTEST) -q -n 2 --dist worksteal -m "not long" 'tests/checks/test_checks.py::test_it_passes[quick-lint]' $(addprefix tests/,$(QUICK))
test-core: $(STAMP)
	$(PYTHON) .ci/core.py $(VENV)
	$(MAKE) -C build/core VENV=.venv on-core
# Half of these tests compute, and each worker collects all of them, at 5 s of CPU time.
on-core: WORKERS := 6
on-core:
	$(AT_ONCE) -q -m "not long" 'tests/checks/test_checks.py::test_it_passes[types]' \
	  'tests/checks/test_checks.py::test_it_passes[quick-lint]' $(addprefix tests/,$(CORE))
coverage: $(STAMP) system
	$(AT_ONCE) -m "not long" $(ALL) $(call without,checks network bluetooth release) --cov=rsb_bridge --cov=rsb_console --cov=rsb_extras --cov-report=
	$(BIN)/coverage report --format=total
test-wire: $(STAMP)
	$(PYTEST) tests/wire --cov=rsb_bridge.wire --cov-branch --cov-fail-under=100
test-%: $(STAMP) system
	$(PYTEST) $(or $(wildcard tests/$* extras/rsb_extras/$*/tests),tests/$*)

quick-lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache
types: $(STAMP)
	$(BIN)/mypy
lint: quick-lint types

SECONDS := $(if $(filter fuzz,$(MAKECMDGOALS)),300,1800)
soak fuzz: $(STAMP)
	$(BIN)/python -m tests.$@ --seconds $(SECONDS)
bench: $(STAMP)
	$(BIN)/python -m bench.run
# The C library of the last is built with cmake and read with libclang (apt install cmake libclang-dev).
PEERS := dds_programs zenoh_bridge
peers:
	@if command -v cargo > /dev/null; then \
	  for each in $(PEERS); do cargo build --release --locked --manifest-path bench/peers/$$each/Cargo.toml || exit 1; done; \
	else echo "no cargo here: $(PEERS) are not built, and benchmarks run without them"; fi
# Programs with other DDS at either end of a bridge, beside nodes of Jazzy and, with keys, of Kilted. It needs root, and `make peers` before.
JSON := docs/figures/foreign_dds.json
foreign: $(STAMP) system
	$(MAKE) VENV=.venv-kilted ROS_EXTRAS=ros-kilted$(comma)ros-kilted-test$(comma) .venv-kilted/.installed
	$(BIN)/python -m pip install --quiet rosbridge-server-rs==0.1.6 websockets
	mkdir -p $(dir $(JSON))
	for each in $(VENV) .venv-kilted; do \
	  OTHER_PYTHON=$(abspath .venv-kilted)/bin/python $$each/bin/python -m bench.foreign_dds --json $(JSON) \
	    $$([ $$each = $(VENV) ] || echo --cases keyed,keyed_latched) || exit 1; \
	done
dist deb lock:
	.ci/release.sh $@
# Pictures of real terminals also need Xvfb, kitty, xterm, ImageMagick and DejaVu's font; without them, it draws the others.
screenshots texts plots: $(STAMP)
	$(BIN)/python docs/$@.py
	$(if $(filter plots,$@),$(BIN)/python docs/foreign_table.py)
man: $(STAMP)
	$(BIN)/python docs/manpage.py

system:
	@.ci/system.sh
$(STAMP): pyproject.toml $(wildcard extras/rsb_extras/*/__init__.py)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python >= 3.11 is needed; say which with PYTHON=..."; exit 1; }
	@[ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV)
	@$(PYTHON) .ci/install.py $(BIN)/python '.[$(EXTRAS)]'
	@touch $@
clean:
	rm -rf $(VENV) .venv-* build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage
