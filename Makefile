# The README's commands, and CI's, are these. Each sets up .venv by itself where that is still to do.
.DEFAULT_GOAL := help
.PHONY: help setup report test test-all check bench clean

BIN := .venv/bin
PYTEST ?= $(BIN)/python -m pytest

help: ## list the commands
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-9s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## put everything into .venv, and find or install a usable libLLVM
	@bash scripts/setup.sh

report: setup ## simulate liver tissue, measure it, compare it, write the HTML report
	@$(BIN)/livlab run experiments/spectral.toml

test: setup ## the tests that take minutes
	$(PYTEST)

test-all: setup ## those, and the slow ones
	$(PYTEST) -m ""

check: setup ## lint, formatting, types, doctests, architecture, the installed wheel
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(PYTEST) -q --doctest-modules livlab
	$(PYTEST) -q tests/architecture
	bash scripts/smoke_wheel.sh

bench: setup ## time the cases that the tests check
	$(BIN)/python -m benchmarks

clean: ## remove caches and build products; runs/ and .venv stay
	rm -rf build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -path ./.venv -prune -o -type d -name __pycache__ -exec rm -rf {} +
