#!/usr/bin/env bash
# Builds the program with object storage, starts a server that speaks S3, and runs the tests against it, with what goes wrong
# on networks in between: test.sh [FOLDER], of an environment that `environment.sh` made beforehand. `cargo build --release`
# came before.
set -euo pipefail
cd "$(dirname "$0")/../.."
env=$(mktemp -d)
trap 'rm -rf "$env"' EXIT

# Chosen together, they have the features of the program: what they depend on is built once.
choice=(-p simod-storage -p simod-cli --features simod-cli/object-storage)
cargo build --release --locked "${choice[@]}"
cargo test --release --locked "${choice[@]}" -- --show-output

venv=${1:-$env/venv}
[ -e "$venv/complete" ] || host/storage/environment.sh "$venv"
python="$venv/bin/python"

# What other programs add to pytest is none of ours.
export PYTEST_DISABLE_PLUGIN_AUTOLOAD=1
export SIMOD="${CARGO_TARGET_DIR:-$PWD/target}/release/simod"
status=0
"$python" -m pytest -p no:cacheprovider -p xdist -n 4 -rs host/storage/tests | tee "$env/log" || status=$?

# As cargo's tests have it, for the line over all.
"$python" - "$env/log" <<'END'
import re, sys
last = open(sys.argv[1]).read().splitlines()[-1]
count = lambda what: sum(int(n) for n in re.findall(rf"(\d+) (?:{what})", last))
print(f"test result: storage. {count('passed')} passed; {count('failed|error')} failed; {count('skipped')} ignored")
END
exit "$status"
