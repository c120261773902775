# make serve   start the service with a demo library      make test    run all tests
# make check   lint, types, layers and tests              make bench   measure against peers

PYTHON ?= python3
HOST ?= 127.0.0.1
PORT ?= 8000
WORKERS ?= $(shell nproc 2>/dev/null || echo 2)
BIN := .venv/bin

.PHONY: serve test lint types layers check bench reliability openapi clean clean-kernels

serve: .venv/run
	$(BIN)/unbend demo --library demo.db
	$(BIN)/unbend serve --library demo.db --host $(HOST) --port $(PORT)

test: .venv/test
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

lint: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/test
	$(BIN)/mypy

layers: .venv/test
	$(BIN)/lint-imports

check: lint types layers test

bench: .venv/bench
	$(BIN)/python benchmarks/geodesics.py
	$(BIN)/python benchmarks/stretched.py
	$(BIN)/python benchmarks/defects.py
	$(BIN)/python benchmarks/embedding.py
	$(BIN)/python benchmarks/paper.py
	$(BIN)/python benchmarks/retrieval_choice.py
	$(BIN)/python benchmarks/retrieval.py
	$(BIN)/python benchmarks/classification.py
	$(BIN)/python benchmarks/rerank.py
	$(BIN)/python benchmarks/robustness.py
	$(BIN)/python benchmarks/seams.py
	$(BIN)/python benchmarks/search.py
	$(BIN)/python benchmarks/service.py
	$(BIN)/python benchmarks/deletion.py

# An hour: processes killed, damaged files, requests made up from the OpenAPI document, each by the thousands.
reliability: .venv/test
	$(BIN)/python benchmarks/reliability.py
	$(BIN)/python benchmarks/fuzz.py
	$(BIN)/python benchmarks/contract.py

openapi: .venv/run
	$(BIN)/unbend openapi -o openapi/openapi.json

# Numba keeps compiled kernels, and does not see a change in a module that a kernel was compiled from.
clean-kernels:
	find service -name '*.nb[ic]' -delete

clean: clean-kernels
	rm -rf .venv demo.db demo.db-wal demo.db-shm

.venv/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=...")'
	$(PYTHON) -m venv .venv
	touch $@

.venv/run: .venv/python pyproject.toml
	$(BIN)/pip install --quiet --editable .
	touch $@

.venv/test: .venv/python pyproject.toml
	$(BIN)/pip install --quiet --editable '.[test]'
	touch $@ .venv/run

.venv/bench: .venv/python pyproject.toml
	$(BIN)/pip install --quiet --editable '.[bench]'
	touch $@
