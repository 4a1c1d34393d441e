# SPDX-License-Identifier: Apache-2.0
# A bare machine needs Python 3.11 or newer, gcc, g++, cmake and make; everything else goes into .venv/, build/ and install/.
#
# With a ROS 2 Jazzy, Kilted or Lyrical sourced, its rclpy, colcon and ros2 are used and .venv/ holds the libraries only.
# docs/howto/existing_ros.md has the same steps by hand.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

# The first Python on PATH that is new enough, so that an older python3 does not stop the set-up.
PYTHON ?= $(shell for p in python3 python3.11 python3.12 python3.13 python3.14; do \
    if $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then echo $$p; exit; fi; done; echo python3)
RUN := source ./env.bash &&
LINTED := conftest.py src test tools $(wildcard benchmarks)

export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYTHONUNBUFFERED := 1

ifdef ROS_DISTRO
  VENV_OPTIONS := --system-site-packages
  LOCKS := requirements.lock
else
  VENV_OPTIONS :=
  LOCKS := requirements.lock requirements-ros.lock
endif
# As a module, so that the programs it installs start with the Python of .venv/, whichever started colcon's own script.
COLCON := python -m colcon

# Python files are linked, not copied: only what decides *which* files are installed asks for a new build.
MESSAGES := $(wildcard src/labyrinth_msgs/*/*.msg src/labyrinth_msgs/*/*.srv src/labyrinth_msgs/*/*.action)
MANIFESTS := $(wildcard src/*/package.xml src/*/setup.py src/*/setup.cfg src/*/CMakeLists.txt src/*/launch/*.py) colcon.meta
DATA := $(shell find src/*/config)

.PHONY: help setup demo test studies lint format docs lock clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@echo "After make setup: source env.bash, then ros2 run labyrinth_sim sim_node and the like."

setup: install/.built ## install libraries and ROS 2 into .venv and build the workspace; nothing to do the second time

demo: setup ## find what an emulated rig hides: gap, where, why, add, gap again; EFFECT=NAME hides another, EFFECT=? any
	@$(RUN) ros2 run eps_tunnel_analysis demo $(if $(EFFECT),--effect '$(EFFECT)') $(DEMO_OPTIONS)

# Three workers, for two cores: conftest.py gives one of them the tests that run against real time, which mostly wait.
WORKERS := -n 3 --dist loadgroup --no-loadscope-reorder
# The tests start hundreds of processes, each of which would compile every module again that it imports.
TESTS := PYTHONDONTWRITEBYTECODE= python -m pytest $(WORKERS)

test: setup ## run the tests, but for long studies; PYTEST='-k tunnel -x' passes options on
	@$(RUN) $(TESTS) -m 'not study' $(PYTEST)

studies: setup ## run the long studies among the tests, too: whole diagnoses, loops and pages of the docs
	@$(RUN) $(TESTS) -m study $(PYTEST)

lint: setup ## check style, formatting and types
	@$(RUN) ruff check $(LINTED)
	@$(RUN) ruff format --check $(LINTED)
	@$(RUN) mypy

format: setup ## put the sources into the house format
	@$(RUN) ruff check --fix $(LINTED); ruff format $(LINTED)

DOCS := build/docs
ALONE := env -u PYTHONPATH -u LD_LIBRARY_PATH

docs: ## build the pages as a site that can be searched: out/docs; it fetches nothing when it is read
	@if [ ! -x $(DOCS)/bin/python ] || [ requirements-docs.txt -nt $(DOCS)/.installed ]; then \
	    $(PYTHON) -m venv $(DOCS) && $(ALONE) $(DOCS)/bin/python -m pip install --no-input -q -r requirements-docs.txt && \
	    touch $(DOCS)/.installed; fi
	@$(ALONE) NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/python -m mkdocs build --strict
	@echo "out/docs/index.html; its search needs a server: python3 -m http.server --directory out/docs"

lock: setup ## pin what requirements*.txt need, with hashes: requirements*.lock; delete those first for the newest releases
	@$(RUN) python tools/lock.py

ifneq ($(wildcard benchmarks/paper.py),)
.PHONY: paper
paper: setup ## repeat the paper's tables and figures on the emulated testbed
	@$(RUN) python benchmarks/paper.py
endif

clean: ## remove what setup made; recordings and reports in out/ stay
	rm -rf .venv build install log src/*/build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find src test tools -name __pycache__ -prune -exec rm -rf {} +

.venv/.installed: $(LOCKS) tools/check_machine.py
	@$(PYTHON) tools/check_machine.py
	@echo "setup 1/2: $(words $(shell grep -ho '^[a-z0-9._-]*==' $(LOCKS))) libraries into .venv, about two minutes"
	@if [ ! -x .venv/bin/python ]; then $(PYTHON) -m venv $(VENV_OPTIONS) .venv; fi
	@touch .venv/COLCON_IGNORE
	@env -u LD_LIBRARY_PATH -u PYTHONPATH -u _ROS_WHEELS_BOOTSTRAP_COMPLETE \
	    .venv/bin/python -m pip install --no-input --no-deps --require-hashes $(addprefix -r ,$(LOCKS)) 2>&1 \
	    | awk '/^Collecting / && ++n % 25 == 0 {print "  " n " of them are here"} \
	           /^Installing collected/ {print "  installing them"} /^ERROR/ {print} {fflush()}'
	@touch $@

install/.built: .venv/.installed $(MESSAGES) $(MANIFESTS) $(DATA)
	@echo "setup 2/2: workspace into install, about a minute"
	@source ./env.bash underlay && $(COLCON) build --symlink-install --base-paths src \
	    --event-handlers console_direct- console_cohesion- desktop_notification- \
	    --cmake-args -DPython3_EXECUTABLE="$$(command -v python)"
	@touch $@
