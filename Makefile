# The front door. Needs python3 (3.11 or newer) and make; everything else is set up here, in .venv.
#   make demo    set up, fetch the models, fly the demonstration on the simulated fleet
#   make test    set up, pass the tests         make soak    the long counts
#   make check   style, types, floors           make bench   the figures, beside what they are compared with
#   make lock    renew requirements.lock             make px4     fly a real PX4 SITL: M3R_PX4=path/to/px4 make px4
#   make coverage  lines and branches of the pure core (safety/, m3r_app/arbiter/) that its tests reach: all
#   make mutate    whether they notice small changes of it; resumable, an hour
#   make trace   which test holds which requirement

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

PYTHON ?= python3
BIN := .venv/bin
# Voice models that somebody has put beside the project are used before any other.
ifneq ($(wildcard ../shared/models),)
export M3R_MODELS ?= $(CURDIR)/../shared/models
endif

PURE_TESTS := tests/safety tests/test_flights.py tests/test_golden.py $(addprefix tests/m3r_app/test_,$(addsuffix .py,arbiter arbiter_corners \
	out_there modes fusion ground_work hillside properties)) tests/ui/test_no_english_is_parsed.py tests/ui/test_requirements.py

# The export of the requirements decides nothing; the settings' defaults are the limits'.
MUTATION_TESTS := $(filter-out tests/ui/test_requirements.py,$(PURE_TESTS)) \
	tests/config/test_settings.py::test_defaults_are_the_limits_defaults

# Without bytecode on the disk every start compiles a thousand files anew: seconds of the app's, minutes of the tests'.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup models demo test coverage soak trace px4 check bench lock clean mutate

help:
	@sed -n '2,8s/^# *//p' Makefile

setup: .venv/stamp-installed

.venv/stamp-made:
	@sh scripts/make-venv.sh "$(PYTHON)"
	@touch $@

.venv/stamp-installed: .venv/stamp-made requirements.lock pyproject.toml
	@$(BIN)/uv pip install --quiet --compile-bytecode --python $(BIN)/python --require-hashes -r requirements.lock
	@$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation --editable .
	@touch $@

# Not fatal: everything but speech and hands works without models.
models: setup
	@$(BIN)/m3r models fetch || echo "A model is missing: speech or hands cannot be recognised until 'make models' succeeds."

# With a model missing, the same story is flown from scripted buttons in its place.
demo: setup
	@if $(BIN)/m3r models fetch; then \
		$(BIN)/m3r run --audio config/demo/operator.ogg --video config/demo/operator.mp4; \
	else \
		echo "A model cannot be had, so the same story is flown from a script, without recognition."; \
		$(BIN)/m3r run --script config/demo/operator.script; \
	fi

test: models
	@$(BIN)/python -m pytest -n 6 --dist loadgroup

# The pure core alone: what its own tests do not reach is named, with its reason, where it stands.
coverage: setup
	@rm -rf .coverage && mkdir .coverage
	@$(BIN)/python -m coverage run -m pytest -q $(PURE_TESTS)
	@$(BIN)/python -m coverage combine -q
	@$(BIN)/python -m coverage report

# What survives without a reason is named. MUTATE: --only safety/planner.py, say, or --sample 300 --seed 1; --page writes docs/mutation.md.
MUTATE ?=
mutate: setup
	@nice $(BIN)/python -W ignore -m tests.mutation $(MUTATE) $(MUTATION_TESTS)

soak: models
	@M3R_SOAK=1 $(BIN)/python -m pytest --timeout 3600
	@$(BIN)/python scripts/soak_page.py

trace: setup
	@$(BIN)/python -m tests.trace

# Skipped by name, test by test, without M3R_PX4. Needs loopback alone.
px4: setup
	@$(BIN)/python -m pytest --timeout 600 tests/px4

check: setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/mypy benchmarks
	@$(BIN)/lint-imports

bench: models
	@for bench in benchmarks/*.py; do echo "== $$bench"; $(BIN)/python "$$bench"; done

lock: .venv/stamp-made
	@$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --no-annotate \
		--python-version 3.11 --upgrade --group dev --group build --group bench --output-file requirements.lock pyproject.toml

clean:
	rm -rf .venv
