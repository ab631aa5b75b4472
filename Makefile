# SPDX-License-Identifier: Apache-2.0
# `make demo` and `make test` install everything they need: a virtual environment, and system packages by apt.
VENV ?= .venv
DEMO ?= demo_ws
ZENOH_DEMO ?= demo_zenoh_ws
BIN = $(VENV)/bin
# One more than the cores: tests on real software mostly wait for it.
WORKERS ?= $(shell expr $$(nproc) + 1)

.PHONY: help setup vendors vendors-new demo demo-zenoh test test-ros test-full test-all docs docs-links lint bench lock clean

help:
	@echo "make demo    provision the talker/listener example and show the keystore"
	@echo "make demo-zenoh  the same for Zenoh; a talker and a listener exchange data, and others are refused"
	@echo "make test    the complete suite, including the tests on real DDS and Zenoh software"
	@echo "make test-ros  the tests on the ROS 2 that is sourced, in a network of their own"
	@echo "make test-full  the same without sampling: all cases of every exhaustive test"
	@echo "make test-all   the suite on every installed Python from 3.11 on"
	@echo "make vendors-new  unpack newer Fast DDS and Cyclone DDS from Debian into ~/.cache/keymint; nothing is installed"
	@echo "make docs    the documentation as a site, in site/docs/index.html"
	@echo "make docs-links  ask each external link of the documentation whether it is still there (needs the network)"
	@echo "make lint    ruff, mypy, import-linter"
	@echo "make bench   the benchmarks"
	@echo "make lock    resolve requirements.lock again"

setup:
	@.ci/setup $(VENV)

vendors:
	@.ci/setup-vendors.sh

vendors-new:
	@.ci/setup-vendors-new.sh

demo: setup
	@BIN=$(BIN) DEMO=$(DEMO) .ci/demo

demo-zenoh: setup
	@BIN=$(BIN) DEMO=$(ZENOH_DEMO) .ci/demo-zenoh

test: setup vendors vendors-new
	@BIN=$(BIN) WORKERS=$(WORKERS) .ci/test $(PYTEST_ARGS)

test-ros: setup
	@BIN=$(BIN) .ci/test-ros $(PYTEST_ARGS)

test-full: setup vendors vendors-new
	@KEYMINT_FULL=1 BIN=$(BIN) WORKERS=$(WORKERS) .ci/test $(PYTEST_ARGS)

test-all: vendors vendors-new
	@WORKERS=$(WORKERS) .ci/test-all $(PYTEST_ARGS)

docs: setup
	@BIN=$(BIN) .ci/docs site

docs-links: setup
	@BIN=$(BIN) .ci/docs site/links linkcheck

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: setup
	$(BIN)/python benchmarks/fleet.py --rows small,growth
	$(BIN)/python benchmarks/verify.py
	$(BIN)/python benchmarks/decisions.py
	$(BIN)/python benchmarks/proof.py
	$(BIN)/python benchmarks/sizes.py

lock: setup
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
		--no-emit-index-url --extra dev --extra pkcs11 --extra zenoh pyproject.toml -o requirements.lock
	echo hatchling | $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header \
		--no-annotate --no-emit-index-url --extra pkcs11 --extra png -c requirements.lock pyproject.toml - -o image.lock

clean:
	rm -rf $(VENV) $(DEMO) $(ZENOH_DEMO) site
