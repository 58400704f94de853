#!/usr/bin/env bash
# Builds the wheel, installs it into an environment, and runs its tests and the checks of its types there: test.sh [FOLDER],
# of an environment that `environment.sh` made beforehand. `cargo build --release` came before.
set -euo pipefail
cd "$(dirname "$0")"
env=$(mktemp -d)
trap 'rm -rf "$env"' EXIT

venv=${1:-$env/venv}
[ -e "$venv/complete" ] || ./environment.sh "$venv"
python="$venv/bin/python"
"$python" -m maturin build --release --locked --out "$env/wheels" --interpreter "$python"
"$python" -m pip install --quiet --disable-pip-version-check "$env"/wheels/*.whl

# Away from the sources, so that what was installed is what is tested.
here=$PWD
cd "$env"
# What other programs add to pytest is none of ours.
export PYTEST_DISABLE_PLUGIN_AUTOLOAD=1
status=0
"$python" -m pytest --rootdir "$here" -c "$here/pyproject.toml" -p no:cacheprovider -rs "$here/tests" | tee log || status=$?
"$python" -m mypy --strict --cache-dir "$env/mypy" "$here/tests"
"$python" -m mypy --strict --cache-dir "$env/mypy" -p simod
"$python" -m mypy.stubtest simod --mypy-config-file "$here/pyproject.toml"

# As cargo's tests have it, for the line over all.
"$python" - <<'END'
import re
last = open("log").read().splitlines()[-1]
count = lambda what: sum(int(n) for n in re.findall(rf"(\d+) (?:{what})", last))
print(f"test result: python. {count('passed')} passed; {count('failed|error')} failed; {count('skipped')} ignored")
END
exit "$status"
