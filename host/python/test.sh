#!/usr/bin/env bash
# Builds the wheel, installs it into an environment, and runs its tests and the checks of its types there: test.sh [FOLDER],
# of an environment that `tests/environment.sh` made beforehand. `cargo build --release` came before. With `build` or `test`
# behind the folder, it does the one or the other alone.
set -euo pipefail
cd "$(dirname "$0")"
here=$PWD
env=$(mktemp -d)
trap 'rm -rf "$env"' EXIT

venv=${1:-$env/venv}
[ -e "$venv/complete" ] || ../../tests/environment.sh python "$venv"
python="$venv/bin/python"
if [ "${2:-build}" = build ]; then
    "$python" -m maturin build --release --locked --out "$env/wheels" --interpreter "$python"
    "$python" -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps "$env"/wheels/*.whl
fi
[ "${2:-test}" = test ] || exit 0

# Away from the sources, so that what was installed is what is tested.
cd "$env"
# What other programs add to pytest is none of ours.
export PYTEST_DISABLE_PLUGIN_AUTOLOAD=1
status=0
"$python" -m pytest --rootdir "$here" -c "$here/pyproject.toml" -p no:cacheprovider -rs "$here/tests" | tee log || status=$?
"$python" -m mypy --strict --cache-dir "$env/mypy" "$here/tests"
"$python" -m mypy --strict --cache-dir "$env/mypy" -p simod
"$python" -m mypy.stubtest simod --mypy-config-file "$here/pyproject.toml"

"$python" "$here/../../tests/suite_result.py" python log
exit "$status"
