#!/usr/bin/env bash
# Builds the program with object storage, starts a server that speaks S3, and runs the tests against it, with what goes wrong
# on networks in between: test.sh [FOLDER], of an environment that `tests/environment.sh` made beforehand. `cargo build
# --release` came before. With `build` or `test` behind the folder, it does the one or the other alone.
set -euo pipefail
cd "$(dirname "$0")/../.."
env=$(mktemp -d)
trap 'rm -rf "$env"' EXIT

venv=${1:-$env/venv}
[ -e "$venv/complete" ] || tests/environment.sh storage "$venv"
python="$venv/bin/python"
program=$venv/program
if [ "${2:-build}" = build ]; then
    # Chosen together, they have the features of the program: what they depend on is built once. Of the program's own tests
    # none is of storage.
    choice=(--release --locked -p simod-storage -p simod-cli --features simod-cli/object-storage)
    cargo build "${choice[@]}"
    # Aside, with its plugins: whoever builds the program without storage takes its place.
    mkdir -p "$program"
    release=${CARGO_TARGET_DIR:-target}/release
    cp -f "$release/simod" "$release"/libsimod_*.* "$program"
    cargo test "${choice[@]}" --lib -- --show-output
    cargo test "${choice[@]}" --doc -- --show-output
fi
[ "${2:-test}" = test ] || exit 0

# What other programs add to pytest is none of ours.
export PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 SIMOD="$program/simod"
status=0
"$python" -m pytest -p no:cacheprovider -p xdist -n 4 -rs host/storage/tests | tee "$env/log" || status=$?

"$python" tests/suite_result.py storage "$env/log"
exit "$status"
