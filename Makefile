# The README's commands, and CI's, are these. Each sets up .venv by itself where that is still to do.
.DEFAULT_GOAL := help
.PHONY: help setup report dossier test test-all check wheel docs bench fuzz clean

BIN := .venv/bin
PYTEST := $(BIN)/python -m pytest
# Two workers: most tests keep one core busy (set-up, compiling, Mie, files). More would not help, since each worker's
# Dr.Jit takes every core for its kernels. Whole files go to one worker, so what a file computes once is not repeated.
WORKERS ?= -n 2 --dist loadfile
TESTS ?= tests
# Its theme's makers announce a successor at every build otherwise.
SITE := NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

help: ## list the commands
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-9s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## put everything into .venv, and find or install a usable libLLVM
	@bash scripts/setup.sh

report: setup ## simulate liver tissue, measure it, compare it, write the HTML report
	@$(BIN)/livlab run experiments/spectral.toml

dossier: setup ## run or reuse every experiment, and build the site of all claims (dossier/index.html)
	@$(BIN)/livlab validate

test: setup ## the tests that take minutes
	$(PYTEST) $(WORKERS) $(TESTS)

test-all: setup ## those, and the slow ones
	$(PYTEST) $(WORKERS) -m "" $(TESTS)

check: setup ## lint, formatting, types, doctests, architecture, the documentation, the installed wheel
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(PYTEST) -q --doctest-modules livlab
	$(PYTEST) -q tests/architecture
	$(SITE) --quiet
	bash scripts/smoke_wheel.sh

wheel: setup ## build the wheel and use it in a new environment that has only what it declares (downloads)
	bash scripts/smoke_wheel.sh --clean

docs: setup ## the documentation as a site: build/site/index.html
	@$(SITE)

bench: setup ## time the cases that the tests check
	$(BIN)/python -m benchmarks

INPUTS ?= 20000
READERS ?=

fuzz: setup ## search every reader of a user's file for crashes, hangs and bombs (INPUTS=20000 READERS="rig ledger")
	@$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[fuzz]'
	$(BIN)/python -m fuzz --inputs $(INPUTS) $(READERS)

clean: ## remove caches and build products; runs/ and .venv stay
	rm -rf build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -path ./.venv -prune -o -type d -name __pycache__ -exec rm -rf {} +
