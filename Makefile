# Two commands do everything on a fresh machine with Python 3.11+, git, make and a C++ compiler: `make demo`, `make test`.
SHELL := /bin/bash
UV_HOME := .cache/uv-home
UV := $(UV_HOME)/bin/uv
export UV_COMPILE_BYTECODE := 1
# One BLAS thread for each test process: two cores are shared by whatever a test starts.
TEST_ENV := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

.PHONY: demo docs lock wheels page browser test test-faults test-kubernetes check install schemas format images bench-radiance bench-radiance-quality bench-prior bench-prior-variants bench-unet bench-joint study accuracy-and-time bench-masks bench-usd bench-overhead audit fuzz-captures bench-gpu pack-gpu test-properties mutation clean
.DEFAULT_GOAL := help

help: ## what there is to make
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

$(UV):
	python3 -m venv $(UV_HOME)
	$(UV_HOME)/bin/pip install --quiet uv

.venv/.installed: $(UV) pyproject.toml uv.lock $(wildcard lib/*/pyproject.toml stages/*/pyproject.toml orchestrator/pyproject.toml) $(shell find lib/kernels -name '*.cpp' -o -name '*.hpp' -o -name 'CMakeLists.txt')
	$(UV) sync --locked --all-packages
	@touch $@

lock: $(UV) ## write uv.lock anew after a pyproject.toml has changed
	$(UV) lock

install: .venv/.installed ## the locked environment in .venv

wheels: $(UV) ## wheels of every package, to be installed without a checkout, in dist/ [OUT=FOLDER] [OPTIONS="OF uv build"]
	python3 wheels/build.py $(or $(OUT),dist) $(OPTIONS)

demo: .venv/.installed ## take an object out of the demo capture; results in runs/demo
	.venv/bin/inpaint3d run examples/demo/capture --mask examples/demo/mask.yaml --name demo

# The mask page's bundle is committed; its sources, and what the tests drive it with, need npm.
PAGE := stages/mask_authoring/page
BUNDLE := stages/mask_authoring/src/inpaint3d/stages/mask_authoring/page/bundle
$(PAGE)/node_modules/.installed: $(PAGE)/package-lock.json
	npm ci --prefix $(PAGE) --ignore-scripts --no-fund --no-audit
	@touch $@

page: $(PAGE)/node_modules/.installed ## the mask page's bundle anew from its sources, by npm and Vite
	npm run --prefix $(PAGE) build
	cd $(PAGE) && git ls-files --cached --others --exclude-standard | LC_ALL=C sort | xargs sha256sum > $(abspath $(BUNDLE))/SHA256SUMS

browser: ## what the tests of the mask page need, as far as it can be had: Debian's chromium, npm's packages
	-@command -v chromium > /dev/null || if [ "$$(id -u)" = 0 ] && command -v apt-get > /dev/null; then \
	    apt-get update -qq && apt-get install -qq -y --no-install-recommends chromium; \
	    else echo "no chromium: install it, or the mask page is not tested in a browser"; fi
	-@command -v npm > /dev/null && $(MAKE) --no-print-directory $(PAGE)/node_modules/.installed || echo "no npm: the mask page's bundle is not built anew"

test: .venv/.installed browser ## all tests: fast ones first, the real small pipeline last
	$(TEST_ENV) .venv/bin/python -m pytest -q -m "not slow and not kubernetes"
	$(TEST_ENV) .venv/bin/python -m pytest -q -m slow

test-faults: .venv/.installed ## kills, corruptions, damaged inputs, writes that fail, counted; hours [TRIALS="--kills 1000 --corruptions 500"]
	$(TEST_ENV) .venv/bin/python -m tests.faults.trials --out benchmarks/results/reliability.json $(TRIALS)
	$(TEST_ENV) .venv/bin/python -m tests.faults.training_kills --out benchmarks/results/reliability.json
	$(TEST_ENV) .venv/bin/python -m tests.faults.fuzz --out benchmarks/results/reliability.json
	$(TEST_ENV) .venv/bin/python -m tests.faults.write_sites --out benchmarks/results/reliability.json
	$(TEST_ENV) .venv/bin/python -m tests.faults.beside_gc --out benchmarks/results/reliability.json

test-properties: .venv/.installed ## properties under many more inputs, drawn anew; nightly [EXAMPLES=2000]
	$(TEST_ENV) INPAINT3D_EXAMPLES=$(or $(EXAMPLES),2000) .venv/bin/python -m pytest -q tests/stability/test_properties.py

mutation: .venv/.installed ## guards taken out one at a time: do the tests notice? [BENCH_OPTIONS="--only NAME"]
	$(TEST_ENV) .venv/bin/python -m benchmarks.mutation $(BENCH_OPTIONS)

test-kubernetes: .venv/.installed ## every image as a Job of a real cluster [INPAINT3D_CLUSTER, INPAINT3D_IMAGES, AWS_*]
	.venv/bin/python -m pytest -q -s -rs -m kubernetes tests/kubernetes

check: .venv/.installed ## formatting, lint, types, import contracts, schema drift, the last commit's subject
	.venv/bin/ruff format --check .
	.venv/bin/ruff check .
	.venv/bin/basedpyright
	.venv/bin/lint-imports
	.venv/bin/python -m inpaint3d.contracts.schemas --check
	.ci/check_subjects

schemas: .venv/.installed ## write schemas/ from the models, and golden instances of versions that have none
	.venv/bin/python -m inpaint3d.contracts.schemas
	.venv/bin/python -m tests.contracts.make_golden

format: .venv/.installed ## fix what can be fixed, and format
	.venv/bin/ruff check --fix --quiet . || true
	.venv/bin/ruff format .

# What is known against the locked packages; an environment of its own, and the network.
AUDIT_ENV := .cache/audit-env
$(AUDIT_ENV)/.installed: $(UV)
	$(UV) venv --quiet --allow-existing $(AUDIT_ENV)
	$(UV) pip install --quiet --python $(AUDIT_ENV)/bin/python pip-audit
	@touch $@

audit: $(AUDIT_ENV)/.installed ## known vulnerabilities of the locked packages, and an SBOM in .cache/sbom.json
	$(UV) export --quiet --locked --all-packages --format cyclonedx1.5 --output-file .cache/sbom.json
	$(UV) export --quiet --locked --all-packages --no-emit-workspace --no-hashes | grep -v "== 'never'" > .cache/requirements.txt
	$(AUDIT_ENV)/bin/pip-audit --strict --disable-pip --no-deps --requirement .cache/requirements.txt

images: .venv/.installed ## build every image with buildah, write .cache/images.yaml [BUILD="--only NAME -- OPTIONS"]
	.venv/bin/python containers/build.py $(BUILD)

# An environment of its own: what builds the site is no part of the product.
DOCS_ENV := .cache/docs-env
$(DOCS_ENV)/.installed: $(UV) pyproject.toml uv.lock
	UV_PROJECT_ENVIRONMENT=$(abspath $(DOCS_ENV)) $(UV) sync --locked --only-group docs
	@touch $@

docs: $(DOCS_ENV)/.installed ## the documentation as a site in .cache/site
	NO_MKDOCS_2_WARNING=1 $(DOCS_ENV)/bin/mkdocs build --quiet --strict
	@echo "open .cache/site/index.html"

# The peer lives in an environment of its own: nerfstudio pins what the product must not.
PEER_ENV := .cache/radiance-peer
$(PEER_ENV)/.installed: $(UV) benchmarks/radiance/peer/pyproject.toml benchmarks/radiance/peer/uv.lock
	UV_PROJECT_ENVIRONMENT=$(abspath $(PEER_ENV)) $(UV) sync --locked --project benchmarks/radiance/peer
	@touch $@

bench-radiance: .venv/.installed $(PEER_ENV)/.installed ## radiance fields against nerfstudio and the machine [FOX=FOLDER]
	.venv/bin/python -m benchmarks.radiance $(if $(FOX),--fox $(FOX)) $(BENCH_OPTIONS)

bench-radiance-quality: .venv/.installed ## radiance fields on held-out photos [SCENES="NAME=FOLDER ..."]
	.venv/bin/python -m benchmarks.radiance.quality $(SCENES) $(BENCH_OPTIONS)

bench-prior: .venv/.installed ## priors on held-out photos against classical fills CORPUS=FOLDER [PRIOR="FOLDER ..."]
	.venv/bin/python -m benchmarks.prior $(CORPUS) $(if $(PRIOR),--prior $(PRIOR)) $(BENCH_OPTIONS)

bench-prior-variants: .venv/.installed ## which small prior learns most in an hour; hours CORPUS=FOLDER
	.venv/bin/python -m benchmarks.prior.variants $(CORPUS) $(BENCH_OPTIONS)

bench-unet: .venv/.installed ## steps of the UNet against diffusers' of equal size [CORPUS=FOLDER]
	.venv/bin/python -m benchmarks.unet $(if $(CORPUS),--corpus $(CORPUS)) $(BENCH_OPTIONS)

bench-masks: .venv/.installed ## objects pointed at with a few clicks against known masks [STATUE=FOLDER]
	.venv/bin/python -m benchmarks.masks $(if $(STATUE),--statue $(STATUE)) $(BENCH_OPTIONS)

bench-usd: .venv/.installed ## the exported mesh of finished runs against held-out photos RUNS="NAME ..." [BLENDER=PYTHON]
	.venv/bin/python -m benchmarks.usd $(RUNS) $(if $(BLENDER),--blender $(BLENDER)) $(BENCH_OPTIONS)

bench-joint: .venv/.installed ## what fills a hole best: baselines, estimators, the paper; hours [STATUE=FOLDER] [BEAR=FOLDER]
	.venv/bin/python -m benchmarks.joint $(if $(STATUE),--statue $(STATUE)) $(if $(BEAR),--bear $(BEAR)) $(BENCH_OPTIONS)

study: .venv/.installed ## more points of what accuracy costs, going on where it stopped; hours [POINTS=60] [STATUE=FOLDER] [BEAR=FOLDER BEAR_MASK=FILE]
	.venv/bin/inpaint3d study examples/demo/capture --mask examples/demo/mask.yaml --points $(or $(POINTS),60) --out benchmarks/results/study/demo
	$(if $(STATUE),.venv/bin/inpaint3d study $(STATUE) --points $(or $(POINTS),60) --out benchmarks/results/study/statue)
	$(if $(BEAR),.venv/bin/inpaint3d study $(BEAR) --mask $(BEAR_MASK) --points $(or $(POINTS),60) --out benchmarks/results/study/bear)
	$(MAKE) --no-print-directory accuracy-and-time

accuracy-and-time: .venv/.installed ## docs/accuracy-and-time.md and its plots from the studies' results
	.venv/bin/python -m benchmarks.accuracy_and_time

# The peers live in environments of their own.
PEERS := .cache/peers
$(PEERS)/%/.installed: $(UV)
	$(UV) venv --quiet --allow-existing $(PEERS)/$*
	$(UV) pip install --quiet --python $(PEERS)/$*/bin/python $*
	@touch $@

bench-overhead: .venv/.installed $(PEERS)/dvc/.installed $(PEERS)/snakemake/.installed ## no-op stages against DVC and Snakemake: cost, kills, damage
	$(TEST_ENV) .venv/bin/python -m benchmarks.overhead --dvc $(PEERS)/dvc/bin/dvc \
	    --snakemake $(PEERS)/snakemake/bin/snakemake --out benchmarks/results/overhead.json $(BENCH_OPTIONS)
	$(TEST_ENV) .venv/bin/python -m benchmarks.peer_faults --dvc $(PEERS)/dvc/bin/dvc \
	    --snakemake $(PEERS)/snakemake/bin/snakemake --out benchmarks/results/peer_faults.json

bench-gpu: .venv/.installed ## a GPU: correctness, rates, the prior of 128 pixels OUT=FOLDER [CORPUS="FOLDER ..."] [PRIOR=FOLDER]
	.venv/bin/python -m benchmarks.gpu --out $(OUT) $(if $(CORPUS),--corpus $(CORPUS)) $(if $(PRIOR),--prior $(PRIOR)) $(BENCH_OPTIONS)

pack-gpu: .venv/.installed ## the same as a folder for a machine without a network PHOTOS="FOLDER ..." [PRIOR=FOLDER] [SCENE=FOLDER]
	.venv/bin/python -m benchmarks.gpu.pack $(PHOTOS) $(if $(PRIOR),--prior $(PRIOR)) $(if $(SCENE),--scene $(SCENE)) $(BENCH_OPTIONS)

fuzz-captures: .venv/.installed ## captures damaged at random: read or refused, nothing else [COUNT=20000]
	$(TEST_ENV) .venv/bin/python -W error -m tests.fuzz_captures --count $(or $(COUNT),20000) \
	    --out benchmarks/results/captures_fuzz.json

clean: ## remove the environment and results (the store too)
	rm -rf .venv .cache .inpaint3d runs gpu-pack
