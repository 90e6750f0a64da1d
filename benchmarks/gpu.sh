#!/usr/bin/env bash
# A real GPU, on a machine without network: benchmarks/gpu.py.
#
#   benchmarks/gpu.sh prepare FOLDER [--quick]    here: bundles, wheels, Vulkan loader and validation layer, all in FOLDER
#   FOLDER/gpu.sh run OUT.json [--validation ..]  there, the tables at the end: needs a GPU's driver, Python 3.10 or later, and dpkg-deb if it has no loader
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
python="${PYTHON:-python3}"
kind="${1:?prepare FOLDER or run OUT.json}"
shift
if [ "$kind" = prepare ]; then
    folder="${1:?prepare needs a folder}"
    mkdir -p "$folder/wheels" "$folder/debs"
    folder="$(cd "$folder" && pwd)"
    "$python" "$here/gpu.py" prepare "$folder" "${@:2}"
    cp "${BASH_SOURCE[0]}" "$folder/gpu.sh"
    for version in ${PYTHON_VERSIONS:-3.10 3.11 3.12 3.13}; do
        "$python" -m pip download -q --no-deps --only-binary :all: --python-version "$version" -d "$folder/wheels" numpy msgpack ||
            echo "gpu.sh: no wheels for Python $version: there it must have numpy and msgpack itself" >&2
    done
    (cd "$folder/debs" && apt-get -q download libvulkan1 vulkan-validationlayers) ||
        echo "gpu.sh: no loader carried along: there it must have libvulkan.so.1 itself" >&2
    du -sh "$folder"
elif [ "$kind" = run ]; then
    if ! "$python" -c 'import numpy, msgpack' 2>/dev/null; then
        "$python" -m pip install -q --no-index --find-links "$here/wheels" --target "$here/site" numpy msgpack
    fi
    export PYTHONPATH="$here/site${PYTHONPATH:+:$PYTHONPATH}"
    if [ ! -d "$here/loader" ] && ls "$here"/debs/*.deb >/dev/null 2>&1; then
        for package in "$here"/debs/*.deb; do dpkg-deb -x "$package" "$here/loader"; done
    fi
    if [ -d "$here/loader" ]; then
        libraries="$(dirname "$(find "$here/loader" -name libVkLayer_khronos_validation.so | head -1)")"
        export VK_LAYER_PATH="$here/loader/usr/share/vulkan/explicit_layer.d"
        export LD_LIBRARY_PATH="${LD_LIBRARY_PATH:+$LD_LIBRARY_PATH:}$libraries"
    fi
    status=0
    "$python" "$here/gpu.py" run "$@" || status=$?
    "$python" "$here/gpu.py" tables "$1"
    exit "$status"
else
    echo "gpu.sh: $kind is neither prepare nor run" >&2
    exit 2
fi
