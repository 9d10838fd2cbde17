# Everything is installed into .venv; Debian/Ubuntu libraries by .ci/system-packages.
PYTHON ?= python3
# Or each process that tests start would compile all modules that it imports.
unexport PYTHONDONTWRITEBYTECODE
VENV := .venv
BIN := $(VENV)/bin
WEB := viewer/web
# The pip that comes with Python may be years old, and install half as fast.
NEW_VENV := .ci/dots $(PYTHON) -m venv --upgrade-deps $(VENV)
# Without the warnings of setuptools, which that pip shows.
PIP := PYTHONWARNINGS=ignore .ci/dots $(BIN)/python -m pip --disable-pip-version-check --quiet

.PHONY: demo quick test extras test-all lint check wheel docs web boundscheck scaling suite paper fuzz peers dist release clean

demo: $(VENV)/installed
	@mkdir -p demo
	@echo; echo "1. A scene of 50,000 Gaussians, and 24 cameras around it"
	$(BIN)/python samples/generate.py demo/still_life.ply --gaussians 50000 --sh-degree 3 --cameras demo/cameras.json --overwrite
	@echo; echo "2. Encode it; the first run compiles kernels, which takes some seconds"
	$(BIN)/gs-codec encode demo/still_life.ply demo/still_life.egs --overwrite
	$(BIN)/gs-codec inspect demo/still_life.egs
	@echo; echo "3. Decode it to a PLY that any viewer opens"
	$(BIN)/gs-codec decode demo/still_life.egs demo/decoded.ply --overwrite
	@echo; echo "4. The loss by attribute; most of it is invisible"
	$(BIN)/gs-codec compare demo/still_life.ply demo/decoded.ply
	@echo; echo "5. The visible loss; at 48 dB the mean error is one level of 255"
	$(BIN)/gs-codec compare demo/still_life.ply demo/still_life.egs --cameras demo/cameras.json --images demo/views --overwrite
	$(BIN)/gs-viewer demo/still_life.ply demo/still_life.egs --cameras demo/cameras.json --view 2 --layers error \
	    --width 1000 --height 400 --screenshot demo/picture.png --overwrite
	@echo; echo "Done. demo/picture.png: the scene, and the error of each pixel; demo/views: every view before and after,"
	@echo "and the difference amplified ten times; demo/decoded.ply: the decoded scene. To show both in a window:"
	@echo "    $(BIN)/gs-viewer demo/still_life.ply demo/still_life.egs --cameras demo/cameras.json"
	@echo "Next: samples/TUTORIAL.md, five minutes; or $(BIN)/gs-codec encode YOUR.ply YOUR.egs"

# Tests run in WORKERS processes at once, by default one more than processors, as some tests wait. A file's tests
# share what takes long, so one worker runs them all; one that crashes or hangs ends the run, and is named.
WORKERS ?= $(shell $(PYTHON) -c 'import os; print(os.cpu_count() + 1)')
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder --max-worker-restart 0

# One test of each file, in one process. The first run compiles kernels.
quick: $(VENV)/installed-test
	$(BIN)/python -m pytest --quick

# What CI runs: no tests marked `thorough` or left out by `one_in`, which take seconds and repeat what others show in
# other processes, windows, browsers or real scenes, for every bit, or for all cases of large tables. Tests whose
# requirements are missing are skipped; `make extras` installs these.
test: $(VENV)/compiled
	$(PYTEST) -m "not thorough"

extras: $(VENV)/installed-all $(WEB)/node_modules/.package-lock.json tests/web/node_modules/.package-lock.json

# Every test, and the lines of each module that none of them runs.
test-all: extras $(VENV)/compiled
	$(PYTEST) --cov --cov-report=term

# What tests import is compiled once, before every worker would. If that fails, tests say why.
$(VENV)/compiled: $(VENV)/installed-test
	@$(BIN)/python -m pytest --collect-only --quiet >/dev/null || true
	@touch $@

lint: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/codespell
	$(BIN)/proselint check --config .ci/proselint.json *.md gs_codec samples viewer/*.md viewer/web/*.md

check: lint test

# A wheel for this Python, with kernels compiled for Linux on x86-64: dist/gs_codec-*.whl. A minute or two.
SOURCE ?= .
wheel: $(VENV)/installed-test
	@rm -rf build/lib
	GS_CODEC_KERNELS=1 $(PIP) wheel --no-deps --no-build-isolation --wheel-dir dist $(SOURCE)

# The documentation as a site, to be opened in a browser.
docs: $(VENV)/installed
	$(PIP) install -e '.[docs]'
	$(BIN)/python samples/documentation.py build/docs

# The page of `gs-codec share` for browsers, which is kept beside its sources and built again after they change: Node 18
# and npm, which fetches what package-lock.json names.
web: $(WEB)/node_modules/.package-lock.json
	@echo "Building $(WEB)/page.html"
	@npm --prefix $(WEB) run --silent build

# esbuild for the page; for tests playwright-core, PlayCanvas, three.js and Spark.
%/node_modules/.package-lock.json: %/package-lock.json
	@command -v npm >/dev/null || { echo "$*: needs Node 18 and npm" >&2; exit 1; }
	@echo "Installing the packages of $*/package.json"
	@npm --prefix $* ci --silent --no-audit --no-fund

# Time and memory of a sample tiled to up to 3 million Gaussians, and a plot: build/scaling/report. A few minutes.
scaling: $(VENV)/installed-test
	@mkdir -p build/scaling
	$(BIN)/python samples/generate.py build/scaling/sample.ply --gaussians 200000 --sh-degree 3 --overwrite
	$(BIN)/gs-codec bench suite build/scaling/sample.ply --out build/scaling/report --overwrite --skip memory --skip codecs --skip curves --skip geometry

# Two samples and SCENES="a/point_cloud.ply ...", cameras.json and images beside each: build/suite/report.
# Half an hour with a scene of 200,000 Gaussians; OPTIONS="--skip pruned" leaves that out. Other codecs are
# measured if they are installed: run `make peers` before.
SAMPLE := build/suite/still_life
suite: $(VENV)/installed-test
	@mkdir -p $(SAMPLE)_60k $(SAMPLE)_100k
	$(BIN)/python samples/generate.py $(SAMPLE)_60k/point_cloud.ply --gaussians 60000 --sh-degree 3 --seed 1 --cameras $(SAMPLE)_60k/cameras.json --overwrite
	$(BIN)/python samples/generate.py $(SAMPLE)_100k/point_cloud.ply --gaussians 100000 --sh-degree 1 --seed 2 --cameras $(SAMPLE)_100k/cameras.json --overwrite
	$(BIN)/gs-codec bench suite $(SCENES) $(SAMPLE)_60k/point_cloud.ply $(SAMPLE)_100k/point_cloud.ply --out build/suite/report --overwrite $(OPTIONS)

# The paper's experiment on a capture with more Gaussians than its views need, as the paper's scenes have, trained here:
# build/paper/report. About five minutes.
paper: $(VENV)/installed-test
	@mkdir -p build/paper
	$(BIN)/python samples/generate.py --capture orbit build/paper/orbit --gaussians 80000 --iterations 3000 --seed 1 --overwrite
	$(BIN)/gs-codec bench paper build/paper/orbit/point_cloud.ply --out build/paper/report --overwrite

# Every reader, one after another, MINUTES each; findings are kept in the folder `fuzz`.
MINUTES ?= 30
TARGET ?= all
fuzz: $(VENV)/installed-test
	$(PIP) install -e '.[fuzz]'
	$(BIN)/python tests/fuzz/fuzz.py $(TARGET) --minutes $(MINUTES) --corpus fuzz

# Other programs: codecs for `gs-codec bench peers` and `bench suite`, and viewers, and tests that they
# read what we write. Prints which could not be installed. spz brings its own zstd: Debian's library
# cannot be linked into a module. SPZ=FOLDER: from a checkout.
SPZ ?= git+https://github.com/nianticlabs/spz
PEERS_LOG := $(VENV)/peers.log
NODE_PACKAGES := @playcanvas/splat-transform@3 playcanvas@2 @sparkjsdev/spark@2 three gltf-validator playwright-core@1.56 cesium@>=1.145
peers: $(VENV)/installed-test
	@.ci/system-packages peers || true
	@CMAKE_ARGS="-DCMAKE_DISABLE_FIND_PACKAGE_zstd=ON $$CMAKE_ARGS" $(PIP) install "$(SPZ)" >$(PEERS_LOG) 2>&1 \
	    || echo "spz: not installed (needs git, a C++ compiler and GitHub); see $(PEERS_LOG)"
	@$(PIP) install 'gsply[sogs]' gsplat >>$(PEERS_LOG) 2>&1 || echo "gsply, gsplat: not installed; see $(PEERS_LOG)"
	@npm install --prefix $(VENV)/peers --ignore-scripts --no-audit --no-fund $(NODE_PACKAGES:%='%') \
	    >>$(PEERS_LOG) 2>&1 || echo "splat-transform, PlayCanvas, Spark, CesiumJS, gltf-validator: not installed (need Node 18 and npm); see $(PEERS_LOG)"
	@npm install --prefix $(VENV)/peers --ignore-scripts --no-audit --no-fund 3d-tiles-validator \
	    >>$(PEERS_LOG) 2>&1 || echo "3d-tiles-validator: not installed; see $(PEERS_LOG)"
	$(PYTEST) tests/test_peers.py tests/test_programs.py tests/test_tiles.py

# Every index of every kernel checked; kernels so compiled are kept apart from the others.
boundscheck: $(VENV)/installed-test
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=$(CURDIR)/$(VENV)/boundscheck \
	    $(PYTEST) --ignore tests/test_viewer_window.py --ignore tests/test_viewer_more.py $(TESTS)

# What is published, built from a clone of the last commit: source distributions, and from these wheels for any system.
dist:
	rm -rf build/release dist
	git clone --quiet . build/release/gs_codec
	$(PYTHON) -m venv --upgrade-deps build/release/venv
	build/release/venv/bin/python -m pip --quiet install build twine
	build/release/gs_codec/.ci/core build/release/gs_codec_core
	for each in gs_codec gs_codec_core; do SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) \
	    build/release/venv/bin/python -m build --outdir dist build/release/$$each || exit 1; done
	build/release/venv/bin/twine check --strict dist/*

# The same, wheels with compiled kernels, recipes for conda and Homebrew, and checksums; each is installed and used in a
# new environment.
release: dist
	$(MAKE) wheel SOURCE=build/release/gs_codec
	$(MAKE) wheel SOURCE=build/release/gs_codec_core
	for file in dist/*; do $(PYTHON) .ci/try_install.py $$file || exit 1; done
	$(PYTHON) .ci/check_kernels.py dist/gs_codec-*-manylinux*.whl
	$(PYTHON) .ci/recipes.py dist
	cat dist/SHA256SUMS

# Modules are compiled when they are imported: all of them would take half of the time to install.
$(VENV)/installed: pyproject.toml .ci/system-packages
	@echo "Installing gs-codec into $(VENV): 1 GB, mostly Open3D, scipy and numba; this takes minutes the first time"
	.ci/dots .ci/system-packages
	$(NEW_VENV)
	$(PIP) install --no-compile -e .
	@touch $@

$(VENV)/installed-test: pyproject.toml .ci/system-packages
	@echo "Installing gs-codec and the tools for tests and lint into $(VENV): pytest, pytest-cov, pytest-xdist, hypothesis, matplotlib, imageio-ffmpeg, Sphinx, ruff, mypy, codespell, proselint, check-jsonschema"
	.ci/system-packages
	$(NEW_VENV)
	$(PIP) install --no-compile -e '.[test]'
	@touch $(VENV)/installed $@

# torch 2.13.0 is pinned because other releases may bring gigabytes of CUDA.
$(VENV)/installed-all: pyproject.toml .ci/system-packages
	@echo "Installing gs-codec and everything that tests need into $(VENV), 2 GB: torch, torchac and g++ for the paper's"
	@echo "coder; Dask and sshfs for clusters and remote storage; OpenCV for photographs; usd-core; openssh-server as a remote storage; Xvfb and xdotool for windows; Node, npm and Chromium"
	.ci/system-packages all
	$(NEW_VENV)
	$(PIP) install --no-compile torch==2.13.0 -e '.[cluster,paper,test,undistort,usd]'
	@touch $(VENV)/installed $(VENV)/installed-test $@

clean:
	rm -rf $(VENV) demo build dist fuzz *.egg-info $(WEB)/node_modules tests/web/node_modules
