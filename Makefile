# The two commands are `make demo` and `make test`. Each does all of its own set-up in .venv.
PYTHON ?= $(firstword $(foreach v,python3.11 python3.12 python3,$(shell command -v $(v) 2>/dev/null)))
VENV := .venv
BIN := $(VENV)/bin
# Outside of a virtual environment pip refuses: a broken .venv must never lead it into the system's Python.
PIP := PIP_REQUIRE_VIRTUALENV=1 $(BIN)/python -m pip --disable-pip-version-check --no-input
# Modules are compiled when they are first imported: to compile all of torch and the like takes a minute or more.
INSTALL := $(PIP) install -q --no-compile
unexport PYTHONDONTWRITEBYTECODE
OUT ?= demo
KILLS ?= 1000
MINUTES ?= 120
SEED ?= 0
CHAOS ?= chaos

CLIENT := flows/view/built/view.js
RECAST := native/build/libmetascenes_recast.so

.PHONY: help client demo test test-whole test-all chaos fuzz check format golden docs pages native open3d train lock clean

help:  ## Say what there is to make.
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

demo: $(VENV)/.compiled  ## Raw scans in, replica scenes out, in ./demo.
	@$(MAKE) --no-print-directory client || echo "make demo: goes on without the viewer, which wants three.js from npm once" >&2
	$(BIN)/metascenes demo --out $(OUT)

test: $(VENV)/.test-ready client check  ## Lint, types and the tests that run in minutes.
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not whole and not slow" --hypothesis-profile same

test-whole: $(VENV)/.test-ready client  ## Whole runs, servers, stores, benchmarks and tests of two seconds.
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "whole and not slow" --hypothesis-profile same

test-all: $(VENV)/.test-ready client check  ## All of these and the slow ones.
	$(BIN)/python -m pytest -n 2 --dist loadfile

chaos: $(VENV)/.run-ready  ## Kill whatever works on small lakes, KILLS times or for MINUTES; goes on where it was stopped.
	$(BIN)/metascenes bench chaos --kills $(KILLS) --minutes $(MINUTES) --seed $(SEED) --folder $(CHAOS)

# As in `make fuzz FUZZ="--targets ply,sens --count 500 --jobs 2"`; `FUZZ=--help` says what else there is.
fuzz: $(VENV)/.test-ready  ## Tens of thousands of changed inputs for all that reads files of others; goes on where it stopped.
	$(BIN)/python -m tests.fuzzing $(FUZZ)

check: $(VENV)/.test-ready  ## Lint and types.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.test-ready  ## Format the code.
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

golden: $(VENV)/.test-ready  ## Write the golden files and generated pages anew, after a change on purpose.
	@$(BIN)/python -m tests.contributing.golden_files

docs: pages $(VENV)/.docs-ready  ## Build the site of the documentation in ./site.
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "site/index.html; with its search: python -m http.server -d site"

pages: $(VENV)/.run-ready  ## Write the pages of tables, views, settings and commands from the schemas, the SQL and the code.
	$(BIN)/python -m warehouse.questions.catalog
	$(BIN)/python -m flows.documentation

train: $(VENV)/.train-ready  ## Install what training needs besides: torch, for graphics cards where the index has that build.

open3d: $(VENV)/.open3d-ready  ## Install Open3D, which finds poses of frames; wants Debian's libgl1, libegl1, libx11-6, libusb-1.0-0, libudev1, libidn2-0.

client: $(CLIENT)  ## Build what browsers get of the viewer, with three.js from npm; Node comes from PyPI where there is none.

$(CLIENT): requirements/client.py requirements/client.lock $(wildcard flows/view/client/* flows/view/client/.npmrc flows/view/client/src/* flows/view/client/src/*/*) | $(VENV)/.made
	$(BIN)/python requirements/client.py

native: $(RECAST)  ## Build the path finder that bakes as habitat-sim; wants Debian's librecast-dev and g++.

$(RECAST): native/recast.cpp
	@echo '#include <recastnavigation/Recast.h>' | g++ -x c++ -fsyntax-only - 2>/dev/null || \
		{ echo "make native: install g++ and librecast-dev first (apt-get install g++ librecast-dev)" >&2; exit 1; }
	mkdir -p $(@D)
	g++ -std=c++17 -O2 -Wall -Wextra -fPIC -shared -Wl,--no-undefined $< -o $@.new -lDetour -lRecast
	mv $@.new $@

# The lock files name versions, no host; --no-deps: nothing that they do not name is installed.
$(VENV)/.made:
	rm -rf $(VENV)
	$(PYTHON) -c 'import sys; assert (3, 11) <= sys.version_info < (3, 13), "Python 3.11 or 3.12 is needed, this is " + sys.version.split()[0]'
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.run-ready: requirements/run.lock pyproject.toml | $(VENV)/.made
	$(INSTALL) --no-deps -r requirements/run.lock
	$(INSTALL) --no-deps --no-build-isolation -e .
	touch $@

# By all cores and once for each kernel; workers would each compile them all. What changes later is compiled when it is called.
$(VENV)/.compiled: $(VENV)/.run-ready
	$(BIN)/metascenes compile
	touch $@

# With what it depends on, in the versions of the lock: a build of torch for graphics cards brings libraries that no lock names.
$(VENV)/.train-ready: requirements/train.lock $(VENV)/.run-ready
	$(INSTALL) -r requirements/train.lock -c requirements/run.lock
	touch $@

$(VENV)/.open3d-ready: requirements/open3d.lock $(VENV)/.run-ready
	$(INSTALL) --no-deps -r requirements/open3d.lock
	@$(BIN)/python -c "import open3d" || { echo "make open3d: install what it links with first" \
		"(apt-get install libgl1 libegl1 libx11-6 libusb-1.0-0 libudev1 libidn2-0)" >&2; exit 1; }
	touch $@

$(VENV)/.test-ready: requirements/test.lock $(VENV)/.train-ready
	$(INSTALL) --no-deps -r requirements/test.lock
	touch $@

$(VENV)/.docs-ready: requirements/docs.lock $(VENV)/.run-ready
	$(INSTALL) --no-deps -r requirements/docs.lock
	touch $@

lock:  ## Resolve the dependencies anew and pin them.
	$(PYTHON) requirements/lock.py

clean:  ## Remove the environment, the site and what the demo made.
	rm -rf $(VENV) $(OUT) native/build flows/view/built site
