# Every target sets up what it needs and may be repeated; the second run is fast.
.DEFAULT_GOAL := help
VENV := .venv
BIN := $(VENV)/bin
# The solver's packages want older versions of some that the project needs.
SOLVER := .venv-symbolic
# So do Sphinx's.
SPHINX := .venv-docs
CHAIN ?= eth-tester
# Test files that run at the same time: those of sites wait for processes, so three keep two cores busy.
JOBS ?= 3

.PHONY: help setup system node-packages demo lab test test-contracts test-python test-long symbolic check experiment bench lint docs release containers contracts clean

help:  ## show the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-10s %s\n", $$1, $$2}'

# -- set-up ------------------------------------------------------------------------------------------

# tools/setup.sh chooses the Python, or names all that is missing in one message; tools/install.py installs.
SETUP = GOAL='$(firstword $(MAKECMDGOALS))' sh tools/setup.sh
SITE := $(VENV)/installed-site
DEV := $(VENV)/installed-dev

$(VENV)/installed-%: pyproject.toml constraints.txt
	@$(SETUP) install $*

$(SOLVER)/stamp: contracts/symbolic/requirements.txt
	@$(SETUP) venv $(SOLVER) $<
	@touch $@

$(SPHINX)/stamp: docs/requirements.txt
	@$(SETUP) venv $(SPHINX) $<
	@touch $@

node_modules/.stamp: package.json package-lock.json
	@$(SETUP) node
	@echo "npm install: Foundry, OpenZeppelin and axe-core, 200 MB on disk" >&2
	@# Not npm ci: it wants the lock to name the binaries of every platform, which not every registry has.
	@npm install --no-save --no-audit --no-fund --loglevel=error
	@touch $@

# The contracts' tools where there is Node. Tests and lint say what they skip without it.
node-packages:
	@if $(SETUP) node 2>/dev/null; then $(MAKE) --silent --no-print-directory node_modules/.stamp; fi

setup: $(DEV) node-packages  ## install all that developing needs; Foundry's tools where there is Node

system:  ## install with apt-get what tests and pictures need: PostgreSQL, Chromium, Node, libEGL, rosidl, systemd, ROS 1
	@$(SETUP) system

# -- what people run ---------------------------------------------------------------------------------

demo: $(SITE)  ## one cleaning task and one charging session, end to end
	@$(BIN)/rodeo demo

lab: $(DEV)  ## a lab without the simulator, on loopback: its devices speak NatNet, Modbus, MJPEG and ROS 2; until its work is paid
	@$(BIN)/python -m tests.reallab

# Python's and the contracts' tests side by side, and one line at the end.
TESTS = $(BIN)/python -m tests --chain $(CHAIN) --jobs $(JOBS) $(if $(MINUTES),--minutes $(MINUTES))

test: $(DEV) node-packages  ## everything that checks the project, but for what takes longest
	@$(TESTS)

test-contracts: $(DEV) node_modules/.stamp
	@$(TESTS) --only contracts

test-python: $(DEV)
	@$(TESTS) --only python

test-long: $(DEV) node-packages $(SOLVER)/stamp  ## the rest: the forgeries, and whole sites that are killed, kept busy, or do without
	@$(TESTS) --long

check: $(DEV)  ## a contributor's loop, about a minute: linters, types, imports, and the unit tests that are fast
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo --no-cache
	@$(BIN)/python -m tests --fast --jobs $(JOBS)

symbolic: $(SOLVER)/stamp node_modules/.stamp  ## what a task pays, by a solver: for all amounts, bonds and penalties
	@node contracts/symbolic.mjs

experiment: $(VENV)/installed-experiment  ## the published experiment twice, about half an hour; out/experiment/paper/report.html
	@$(BIN)/rodeo experiment paper

# Of all areas only the planted bugs need the solver.
bench: $(DEV) $(if $(filter mutants,$(or $(ONLY),mutants)),$(SOLVER)/stamp) node_modules/.stamp  ## measure; ONLY=area limits it (contracts, mutants, evidence, oracle, forgeries, fuzz, kinds, honest, unlisted, margins, robot, itrash, bridge, autonomy, pace, soak, faults, console, outside, lab, cli, extras; by its name alone: verdicts)
	@$(BIN)/python -m bench $(ONLY)

lint: $(DEV) node-packages  ## linters, type checker, imports, sizes of classes, ROS 2 interfaces, the network's answers, built contracts equal to their sources
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo --no-cache
	@$(BIN)/python -m tests.docs.links
	@$(BIN)/python -m tools.shape
	@$(BIN)/python -m rodeo.interfaces.generate --check
	@$(BIN)/python -m training.answers
	@if [ -e node_modules/.stamp ]; then npm run --silent contracts:check; \
	else echo "skipped: whether built contracts equal their sources; Node is missing: make system"; fi

docs: $(SPHINX)/stamp  ## the documentation as a web site; out/docs/index.html
	@$(SPHINX)/bin/sphinx-build -W --keep-going --quiet docs out/docs
	@echo "The documentation is in out/docs/index.html"

release: $(DEV)  ## sdist and wheel in out/dist, checked; the demo from the wheel in empty Debian roots (root, debootstrap)
	@$(BIN)/python -m tools.release

containers: $(DEV)  ## images of a site, built and run with podman until a task is settled (root, debootstrap, podman, runc)
	@$(BIN)/python -m tools.containers

contracts: $(DEV) node_modules/.stamp  ## build the contracts' ABI and bytecode, and their mirror in Python
	@npm run --silent contracts:build
	@$(BIN)/python -m rodeo.chain.contracts.generate

clean:  ## remove what was installed, built and run
	rm -rf $(VENV) $(SOLVER) $(SPHINX) node_modules out var contracts/out contracts/cache
