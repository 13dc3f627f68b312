#!/usr/bin/env bash
# Makes an environment with scjax and skrl: bash experiments/policy/install.sh FOLDER
set -euo pipefail
folder=${1:?give the folder of the new environment}
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
python3 -m venv "$folder"
"$folder/bin/pip" install --quiet --constraint "$root/constraints.txt" --editable "$root[gym]" \
    --requirement "$here/requirements.txt"
"$folder/bin/pip" check
"$folder/bin/python" -c "import skrl; print('skrl', skrl.__version__, 'is there')"
