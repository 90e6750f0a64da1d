# On a fresh Debian 12, `make demo` and `make test` are all there is to know: both make .venv first, and apt what is missing.
# Settings: PYTHON chooses the interpreter (3.10 or later), ARGS goes to pytest, APT_PACKAGES= leaves the system alone.
# DRIVERS: which drivers `make test-drivers` fetches and runs on: quick, all (as it does by itself), everything, or names of
# tests/drivers/catalog.py; `make test` with it runs on them beside the rest.
PYTHON ?= python3
VENV ?= .venv
ARGS ?=
# Two processes, each with whole files of tests; WORKERS= for one. On a fresh machine lavapipe compiles every shader, which takes half of
# the time of tests that draw; with GALLIVM_PERF=nopt in the environment it compiles them as they are, in two thirds of that.
WORKERS ?= -n 2 --dist loadfile
DRIVERS ?=
APT_PACKAGES ?= mesa-vulkan-drivers libvulkan1 glslang-tools spirv-tools vulkan-validationlayers python3-venv \
    gcc libc6-dev libvulkan-dev
# Not needed: it compiles shaders six times as fast as glslang-tools (docs/packing.md).
APT_FASTER ?= glslc

ANDROID_PACKAGES ?= clang-16 lld-16 llvm-16 aapt apksigner android-framework-res libsmali-java android-libnativehelper-dev \
    openjdk-17-jdk-headless qemu-user mmdebstrap libvulkan-dev

READY := $(VENV)/.ready
.ONESHELL:
.SHELLFLAGS := -ec
.DELETE_ON_ERROR:
.PHONY: api setup test test-full test-drivers test-android apk fuzz fuzz-text fuzz-meshes demo clean
export DRIVERS

setup: $(READY)

test: setup
	$(VENV)/bin/ruff check
	$(VENV)/bin/pytest -q $(WORKERS) $(if $(DRIVERS),-m 'not full and not android') $(ARGS)

test-full: setup
	$(VENV)/bin/ruff check
	$(VENV)/bin/pytest -q $(WORKERS) -m 'not drivers and not android' $(ARGS)

test-drivers: setup
	$(VENV)/bin/pytest -q -m drivers tests/test_drivers.py $(ARGS)

# The sample as an APK, of Debian packages alone, and its library on 64-bit ARM under qemu-user: docs/android.md.
test-android: setup
	@$(call install,$(ANDROID_PACKAGES))
	$(VENV)/bin/pytest -q -s -m 'android or not android' tests/test_android.py $(ARGS)

apk: setup
	@$(call install,$(ANDROID_PACKAGES))
	rm -rf build/assets
	PYTHONPATH=. $(VENV)/bin/python android/offline/assets.py build/assets
	$(VENV)/bin/python android/offline/build.py build build/assets

fuzz: setup
	PYTHONPATH=.:tests $(VENV)/bin/python tests/fuzz_bundle.py $(or $(MUTATIONS),200000) $(or $(SEED),0)

fuzz-text: setup
	PYTHONPATH=.:tests $(VENV)/bin/python tests/fuzz_text.py $(or $(MUTATIONS),100000) $(or $(SEED),0)

fuzz-meshes: setup
	PYTHONPATH=.:tests $(VENV)/bin/python tests/fuzz_meshes.py $(or $(MUTATIONS),100000) $(or $(SEED),0)

api: setup
	PYTHONPATH=. $(VENV)/bin/python docs/make_api.py build/api.md

demo: setup
	$(VENV)/bin/dressi-edge demo -o demo_out

clean:
	rm -rf $(VENV) build demo_out *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Installs those of these Debian packages that are missing.
define install
fail() { echo "setup: $$*" >&2; exit 1; }
missing=
for package in $(1); do
    if [ "$$package" = python3-venv ] && $(PYTHON) -c 'import ensurepip, venv' 2>/dev/null; then continue; fi
    dpkg-query -W -f '$${db:Status-Status}\n' "$$package" 2>/dev/null | grep -qx installed || missing="$$missing $$package"
done
if [ -n "$$missing" ]; then
    echo "setup: installing$$missing"
    skip="or, where you have the like already, make setup APT_PACKAGES="
    command -v apt-get >/dev/null || fail "needs what Debian calls$$missing; there is no apt-get here: install them, then run" \
        "make setup APT_PACKAGES="
    as=
    if [ "$$(id -u)" != 0 ]; then
        command -v sudo >/dev/null || fail "needs apt-get install$$missing as root; there is no sudo here; $$skip"
        as=sudo
    fi
    $$as apt-get -qq update || echo "setup: apt-get update failed; trying with the lists at hand" >&2
    $$as env DEBIAN_FRONTEND=noninteractive apt-get -qq -y --no-install-recommends install $$missing >/dev/null ||
        fail "needs apt-get install$$missing, which failed; do it yourself, $$skip"
fi
endef

$(READY): pyproject.toml setup.py Makefile
	@$(call install,$(APT_PACKAGES))
	$(if $(APT_PACKAGES),($(call install,$(APT_FASTER))) || echo "setup: without it all works; shaders take longer to compile" >&2)
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || fail "$(PYTHON) must be Python 3.10 or later; set PYTHON="
	echo "setup: making $(VENV) with $$($(PYTHON) --version)"
	$(PYTHON) -m venv $(VENV) || fail "$(PYTHON) -m venv failed; Debian has it in python3-venv"
	$(VENV)/bin/python -m pip install -q --disable-pip-version-check -e '.[dev]'
	touch $@
