#!/usr/bin/env bash
# Makes an environment with what the tests need: environment.sh FOLDER. Needs python3 (3.11 or later) with venv.
set -euo pipefail
cd "$(dirname "$0")"
python3 -m venv "$1"
# What is imported is compiled then: most of it never is.
"$1/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile -r tests/requirements.txt
touch "$1/complete"
