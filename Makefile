# Every target sets up what it needs and may be repeated; the second run is fast.
.DEFAULT_GOAL := help
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# The solver's packages want older versions of some that the project needs.
SOLVER := .venv-symbolic
# So do Sphinx's.
SPHINX := .venv-docs
CHAIN ?= eth-tester
# What is compiled.
PYX := $(wildcard rodeo/lab/*.pyx services/robot_sim/*.pyx)
# Test files that run at the same time.
JOBS ?= 2

.PHONY: help setup postgresql demo test test-contracts test-python test-long test-contracts-long test-python-long symbolic experiment bench lint docs contracts clean

help:  ## show the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-10s %s\n", $$1, $$2}'

# -- set-up ------------------------------------------------------------------------------------------

$(VENV)/stamp: pyproject.toml constraints.txt $(PYX)
	@echo "Installing the Python packages into $(VENV) ..."
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

$(SOLVER)/stamp: contracts/symbolic/requirements.txt
	@echo "Installing the solver into $(SOLVER) ..."
	@test -x $(SOLVER)/bin/python || $(PYTHON) -m venv $(SOLVER)
	@$(SOLVER)/bin/pip install --quiet --disable-pip-version-check --requirement $<
	@touch $@

$(SPHINX)/stamp: docs/requirements.txt
	@echo "Installing Sphinx into $(SPHINX) ..."
	@test -x $(SPHINX)/bin/python || $(PYTHON) -m venv $(SPHINX)
	@$(SPHINX)/bin/pip install --quiet --disable-pip-version-check --requirement $<
	@touch $@

node_modules/.stamp: package.json package-lock.json
	@echo "Installing Foundry and OpenZeppelin from npm ..."
	@command -v npm >/dev/null || { echo "Node.js 20 or newer with npm is needed for the contract tests" >&2; exit 1; }
	@# Not npm ci: it wants the lock to name the binaries of every platform, which not every registry has.
	@npm install --no-save --no-audit --no-fund --loglevel=error
	@touch $@

postgresql:
	@command -v initdb >/dev/null || ls /usr/lib/postgresql/*/bin/initdb >/dev/null 2>&1 \
		|| apt-get install --quiet --yes postgresql >/dev/null 2>&1 \
		|| echo "PostgreSQL is not installed and cannot be installed here: its tests are skipped" >&2

setup: $(VENV)/stamp  ## install what running needs; Foundry's anvil, too, where there is Node
	@if command -v npm >/dev/null; then $(MAKE) --no-print-directory node_modules/.stamp \
		|| echo "anvil could not be installed: \`chain.backend = \"anvil\"\` needs it, nothing else" >&2; \
	else echo "anvil is not installed, as there is no Node.js: \`chain.backend = \"anvil\"\` needs it, nothing else"; fi

# -- what people run ---------------------------------------------------------------------------------

demo: $(VENV)/stamp  ## one cleaning task and one charging session, end to end
	@$(BIN)/rodeo demo

PYTEST = $(BIN)/python -m pytest --chain $(CHAIN) --forks --numprocesses $(JOBS) --dist loadfile --no-loadscope-reorder \
	--durations 25 --durations-min 5

# The contracts beside the rest: their compiler keeps one core busy for minutes, while tests of sites wait for processes
# and for time that passes.
BESIDE = $(MAKE) --no-print-directory --jobs=2 --keep-going
# Whole lives of tasks, in any order, take minutes.
LONG_CONTRACTS = EscrowInvariants
FORGE = mkdir -p out; npm run --silent contracts:test -- $(1) >out/$@.log 2>&1; status=$$?; cat out/$@.log; exit $$status

test: $(VENV)/stamp node_modules/.stamp postgresql  ## everything that checks the project, but for what takes minutes
	@$(BESIDE) test-contracts test-python

test-contracts: node_modules/.stamp
	@$(call FORGE,--no-match-contract $(LONG_CONTRACTS))

test-python: $(VENV)/stamp
	@$(PYTEST) -m "not long"

test-long: $(VENV)/stamp node_modules/.stamp postgresql  ## the rest: the forgeries, and whole sites that are killed, kept busy, or do without
	@$(BESIDE) test-contracts-long test-python-long

symbolic: $(SOLVER)/stamp node_modules/.stamp  ## what a task pays, by a solver: for all amounts, bonds and penalties
	@node contracts/symbolic.mjs

test-contracts-long: export FOUNDRY_INVARIANT_RUNS = 256
test-contracts-long: node_modules/.stamp symbolic
	@$(call FORGE,--match-contract $(LONG_CONTRACTS))

test-python-long: $(VENV)/stamp
	@$(PYTEST) -m long

experiment: $(VENV)/stamp  ## the published experiment twice, about half an hour; out/experiment/paper/report.html
	@$(BIN)/rodeo experiment paper

# Of all areas only the planted bugs need the solver.
bench: $(VENV)/stamp $(if $(filter mutants,$(or $(ONLY),mutants)),$(SOLVER)/stamp) node_modules/.stamp  ## measure; ONLY=area limits it (contracts, mutants, evidence, oracle, forgeries, kinds, honest, margins, robot, itrash, bridge, autonomy, pace, soak, faults, console)
	@$(BIN)/python -m bench $(ONLY)

lint: $(VENV)/stamp node_modules/.stamp  ## linters, type checker, imports, built contracts equal to their sources
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo --no-cache
	@$(BIN)/python -m tests.docs.links
	@npm run --silent contracts:check

docs: $(SPHINX)/stamp  ## the documentation as a web site; out/docs/index.html
	@$(SPHINX)/bin/sphinx-build -W --keep-going --quiet docs out/docs
	@echo "The documentation is in out/docs/index.html"

contracts: $(VENV)/stamp node_modules/.stamp  ## build the contracts' ABI and bytecode, and their mirror in Python
	@npm run --silent contracts:build
	@$(BIN)/python -m rodeo.chain.generate

clean:  ## remove what was installed, built and run
	rm -f $(PYX:.pyx=.c) $(PYX:.pyx=.*.so)
	rm -rf $(VENV) $(SOLVER) $(SPHINX) node_modules out var contracts/out contracts/cache
