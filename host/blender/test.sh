#!/usr/bin/env bash
# Tests the extension with Blender as a module, in an environment of its own: test.sh [FOLDER], of one that
# `tests/environment.sh` made beforehand. `cargo build --release` came before, or SIMOD_PROGRAM names another program. Says so
# and does nothing where Blender's module cannot be installed or started: it is for Python 3.11 alone, and needs libraries of
# X11 and OpenGL.
set -euo pipefail
cd "$(dirname "$0")"
here=$PWD
target=${CARGO_TARGET_DIR:-$here/../../target}
env=$(mktemp -d)
trap 'rm -rf "$env"' EXIT

skip() {
    echo "skipped: the extension for Blender: $1"
    echo "test result: blender. 0 passed; 0 failed; 1 ignored"
    exit 0
}

command -v python3.11 >/dev/null || skip "there is no python3.11"
venv=${1:-$env/venv}
[ -e "$venv/complete" ] || ../../tests/environment.sh blender "$venv" || skip "bpy cannot be installed"
python="$venv/bin/python"
"$python" -c "import bpy" 2>/dev/null || skip "bpy cannot be started, as a library is missing"

export SIMOD_PROGRAM="${SIMOD_PROGRAM:-$target/release/simod}" PYTHONPYCACHEPREFIX="$env/bytecode" BLENDER_USER_RESOURCES="$env/user"
status=0
"$python" -m pytest -p no:cacheprovider -q tests | tee "$env/log" || status=$?

"$python" ../../tests/suite_result.py blender "$env/log"
exit "$status"
