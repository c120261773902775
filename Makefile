# make serve   start the service with a demo library      make test    run all tests
# make check   lint, types, layers and tests              make bench   list or run benchmarks
# make docs    build the documentation into site/
# make release-check, image-check, sbom                   what is released: packages, the container, their content

PYTHON ?= python3
HOST ?= 127.0.0.1
PORT ?= 8000
LIBRARY ?= demo.db
WORKERS ?= $(shell nproc 2>/dev/null || echo 2)
BIN := .venv/bin

.PHONY: serve test lint types layers kernels check bench docs reliability release-check image-check sbom openapi client clean \
	clean-kernels

serve: .venv/run
ifeq ($(LIBRARY),demo.db)
	$(BIN)/unbend demo --library $(LIBRARY)
endif
	$(BIN)/unbend serve --library $(LIBRARY) --host $(HOST) --port $(PORT)

# Tests start hundreds of processes, so Python may save compiled modules. xdist keeps the order of tests/conftest.py.
test: .venv/test
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

lint: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/test
	$(BIN)/mypy

layers: .venv/test
	$(BIN)/lint-imports

# Compiles what tests would compile while they wait: two minutes, or seconds if nothing has changed.
kernels: .venv/test
	$(BIN)/python -c "from unbend.jobs.kernels import compile_kernels; compile_kernels()"

check: lint types layers test

# NAME=retrieval.measures runs one benchmark. Without NAME, this lists the benchmarks.
bench: .venv/bench
	$(BIN)/python -m benchmarks$(if $(NAME),.$(NAME))

# Warnings are errors. The site is static: open site/index.html, or copy the folder to any web server.
docs: .venv/docs
	$(BIN)/python -m sphinx --builder html --fail-on-warning --keep-going --quiet --fresh-env \
		--doctree-dir build/doctrees docs site

# Takes an hour: kills processes, fills a disk (as root), and sends thousands of damaged files and generated requests.
reliability: .venv/test
	$(BIN)/python -m benchmarks.service.reliability
	$(BIN)/python -m benchmarks.service.fuzz
	$(BIN)/python -m benchmarks.service.contract

# Builds the packages, and uses the wheel with the oldest and newest Pythons, and lowest and highest dependencies.
release-check: .venv/release
	$(BIN)/python -m benchmarks.release.packages dist

# Builds the image in a clean Debian, and uses its server with a read-only disk. Needs root, buildah and debootstrap.
image-check: .venv/release
	$(BIN)/python -m benchmarks.release.image

# Writes dist/sbom.json and dist/licences.txt.
sbom: .venv/release
	$(BIN)/python -m benchmarks.release.licences dist

openapi: .venv/run
	$(BIN)/unbend openapi -o openapi/openapi.json

# The synchronous client is written from the asynchronous one.
client: .venv/test
	$(BIN)/python -m tests.support.twin

# Numba caches compiled kernels. It does not notice changes in other modules that a kernel calls.
clean-kernels:
	find service -name '*.nb[ic]' -delete

clean: clean-kernels
	rm -rf .venv site build/doctrees demo.db demo.db-wal demo.db-shm service/unbend/api/page service/web/node_modules

.venv/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "unbend needs Python 3.11 or newer: make PYTHON=...")'
	$(PYTHON) -m venv .venv
	touch $@

.venv/run: .venv/python pyproject.toml
	@echo "Installing unbend and building its page: a minute or more, without output."
	$(BIN)/pip install --quiet --editable .
	touch $@

.venv/test: .venv/python pyproject.toml
	@echo "Installing unbend, its page and the tools of the tests: minutes, without output."
	$(BIN)/pip install --quiet --editable '.[test]'
	touch $@ .venv/run

.venv/release: .venv/python pyproject.toml
	$(BIN)/pip install --quiet --editable '.[test,release]'
	touch $@

.venv/bench: .venv/python pyproject.toml
	$(BIN)/pip install --quiet --editable '.[bench]'
	touch $@

.venv/docs: .venv/python pyproject.toml
	@echo "Installing unbend and the tools of its documentation: a minute or more, without output."
	$(BIN)/pip install --quiet --editable '.[docs]'
	touch $@
