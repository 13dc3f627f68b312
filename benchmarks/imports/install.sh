#!/usr/bin/env bash
# Makes an environment with commonroad-io and Lanelet2 alone: bash benchmarks/imports/install.sh FOLDER
set -euo pipefail
folder=${1:?give the folder of the new environment}
python3 -m venv "$folder"
"$folder/bin/pip" install --quiet --no-deps --only-binary=:all: --requirement "$(dirname "$0")/requirements.txt"
"$folder/bin/pip" check
"$folder/bin/python" -c "import commonroad, lanelet2; print('commonroad-io and lanelet2 are there')"
