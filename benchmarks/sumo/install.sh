#!/usr/bin/env bash
# Makes an environment with SUMO alone: bash benchmarks/sumo/install.sh FOLDER
set -euo pipefail
folder=${1:?give the folder of the new environment}
python3 -m venv "$folder"
"$folder/bin/pip" install --quiet --no-deps --only-binary=:all: --require-hashes \
    --requirement "$(dirname "$0")/requirements.txt"
"$folder/bin/netconvert" --version | head -1
