# Two commands matter: `make run` and `make test`. `make help` lists the rest.
#
# Needs: make and Python 3.11 or later. Everything else comes into .venv, at the versions of
# constraints.txt.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip --disable-pip-version-check --quiet
ARGS   ?=

# Debian packages that some tests need: a software Vulkan driver, to render recordings; a kernel with vcan that
# boots as an ordinary process, for real SocketCAN where the host has none.
SYSTEM_PACKAGES := mesa-vulkan-drivers user-mode-linux kmod iproute2 can-utils gcc libc6-dev rt-tests stress-ng chromium

.DEFAULT_GOAL := help
.PHONY: help run test test-vcan check bench format wheel system-deps pictures docs clean

help: ## this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 14

run: $(VENV)/.run ## drive a train from station to station in real time; ARGS="…" goes to `hil run`
	@$(BIN)/hil run $(ARGS)

test: $(VENV)/.dev check ## everything that must hold, from lint to whole runs; ARGS="…" goes to pytest
ifeq ($(strip $(ARGS)),)
	@$(BIN)/python -m pytest -m "not realtime and not needs_vcan" --numprocesses auto --maxprocesses 4 --dist worksteal
	@$(BIN)/python -m pytest -m "realtime or needs_vcan"
else
	@$(BIN)/python -m pytest $(ARGS)
endif

test-vcan: $(VENV)/.dev ## real SocketCAN: natively, or in a kernel that boots as an ordinary process
	@$(BIN)/python -m pytest tests/vcan $(ARGS)

docs: $(VENV)/.dev ## build the documentation into build/site
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo build/site/index.html

check: $(VENV)/.dev ## ruff, mypy --strict, the import rules and the documentation
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

bench: $(VENV)/.dev ## measure against peers, side by side in one run
	@$(BIN)/python -m benchmarks $(ARGS)

format: $(VENV)/.dev ## put the source into the project's format
	@$(BIN)/ruff check --fix
	@$(BIN)/ruff format

wheel: $(VENV)/.dev ## build dist/*.whl
	@$(BIN)/python -m build --wheel --outdir dist . > /dev/null
	@ls dist/*.whl

pictures: $(VENV)/.dev ## render the pictures of the documentation from a fresh run
	rm -rf runs/pictures runs/pictures-profile runs/pictures-compare
	$(BIN)/hil run --out runs/pictures
	$(BIN)/hil view runs/pictures --render runs/pictures
	cd runs/pictures && cp drive.png law.png timing.png bus.png ../../docs/pictures/
	$(BIN)/hil profile cat_linh_la_thanh "Cat Linh" "La Thanh" --time 78 --compare --out runs/pictures-profile
	cp runs/pictures-profile/profile.png docs/pictures/profile.png
	$(BIN)/hil compare --laws all --out runs/pictures-compare
	cp runs/pictures-compare/compare.png docs/pictures/compare.png

system-deps: ## install the Debian packages that some tests need (root)
	apt-get update
	apt-get install --yes --no-install-recommends $(SYSTEM_PACKAGES)

clean: ## remove what the other targets made, recordings excepted
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "make: needs Python 3.11 or later; name one with PYTHON=python3.x" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.pip: constraints.txt | $(VENV)/bin/python
	@$(PIP) install --constraint constraints.txt --upgrade pip
	@touch $@

$(VENV)/.run: pyproject.toml constraints.txt $(VENV)/.pip
	@echo "setting up $(VENV) (once; the viewer alone is 170 MB)"
	@$(PIP) install --constraint constraints.txt --editable .
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt $(VENV)/.run
	@$(PIP) install --constraint constraints.txt --group dev
	@touch $@
