# Each target sets up all it needs; `make demo` and `make test` are the two to know.
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
OUT ?= out

.PHONY: demo test slow lint bench docs clean

demo: $(STAMP)          ## closed-loop comparison of policies on measured terrain, with pictures
	rm -rf $(OUT)/demo
	$(BIN)/lunarsim compare scenarios/hirise.toml --flights 6 --seed 1 --out $(OUT)/demo
	@echo "Pictures: $(OUT)/demo/figures"

test: $(STAMP)          ## the test suite
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --durations 30

slow: $(STAMP)          ## the tests and studies that take minutes; one of them needs chromium
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[ray]"
	$(BIN)/python -m pytest -n 2 --dist loadfile -m slow

lint: $(STAMP)          ## style, types, and the walls between rooms
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP)         ## speed, as ratios to references in the same run
	$(BIN)/python scripts/bench.py

docs: $(STAMP)          ## the site, in out/docs/index.html
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	$(BIN)/python -m sphinx -W -n --keep-going -b html docs $(OUT)/docs
	@echo "Site: $(OUT)/docs/index.html"

$(STAMP): pyproject.toml scripts/setup.sh
	sh scripts/setup.sh $(VENV)
	@touch $(STAMP)

clean:
	rm -rf $(VENV) $(OUT)
