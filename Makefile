# Each target sets up all it needs; `make demo` and `make test` are the two to know.
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
OUT ?= out

.PHONY: demo test slow lint bench results docs lock sbom clean

demo: $(STAMP)          ## closed-loop comparison of policies on measured terrain, with pictures
	rm -rf $(OUT)/demo
	$(BIN)/lunarsim compare scenarios/hirise.toml --flights 6 --seed 1 --out $(OUT)/demo
	@echo "Pictures: $(OUT)/demo/figures"

# Tests start many processes: they load bytecode, also where PYTHONDONTWRITEBYTECODE is set.
test: $(STAMP)          ## the test suite
	$(BIN)/python -m compileall -q lunarsim envs
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --durations 30

slow: $(STAMP)          ## the tests and studies that take minutes; one of them needs chromium
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.lock --editable ".[ray]"
	$(BIN)/python -m pytest -n 2 --dist loadfile -m slow

lint: $(STAMP)          ## style, types, import contracts, words and names
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python scripts/lint_words.py

bench: $(STAMP)         ## speed, as ratios to references in the same run
	$(BIN)/python scripts/bench.py

results: $(STAMP)       ## the tables of docs/validation that come from docs/results
	$(BIN)/python scripts/results_pages.py

# The tutorials are executed side by side into the cache that Sphinx reads.
# The longest tutorials first, so that both processes end at about the same time.
LONGEST := $(addprefix docs/tutorials/,train-agent.md guidance-law.md papers.md campaign.md p-safe.md own-terrain.md)
TUTORIALS := $(LONGEST) $(filter-out %/index.md $(LONGEST),$(wildcard docs/tutorials/*.md))
CACHE := -p $(OUT)/.jupyter_cache

docs: $(STAMP)          ## the site, in out/docs/index.html
	mkdir -p $(OUT)
	echo y | $(BIN)/jcache notebook $(CACHE) add -r myst_nb_md $(TUTORIALS)
	$(BIN)/jcache project $(CACHE) execute -e local-parallel -t 600
	$(BIN)/python -m sphinx -W -n --keep-going -j auto -b html docs $(OUT)/docs
	@echo "Site: $(OUT)/docs/index.html"

lock:                   ## the tested versions of dependencies (without PyTorch), and their licences
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv "pip>=26"
	$(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 --no-annotate \
		$(foreach extra,ray report sensitivity data onnx fmi view mcap mesh bench docs dev,--extra $(extra)) \
		--custom-compile-command "make lock" pyproject.toml -o requirements.lock
	$(BIN)/python scripts/licences_page.py > docs/about/licences.md

sbom: $(STAMP)          ## the software bill of materials (CycloneDX), in out/sbom.json
	mkdir -p $(OUT)
	$(BIN)/python scripts/sbom.py > $(OUT)/sbom.json

$(STAMP): pyproject.toml requirements.lock scripts/setup.sh
	sh scripts/setup.sh $(VENV)
	@touch $(STAMP)

clean:
	rm -rf $(VENV) $(OUT)
