#!/usr/bin/env bash
# Builds the wheel, installs it into a fresh environment outside the checkout, and plays a
# shipped protocol in an empty folder. Nothing is compiled there yet: were it not compiled before
# the instruments are asked, they would give up waiting. With "plan" it only plans the protocol,
# which compiles nothing.
set -euo pipefail
checkout=$(cd "$(dirname "$0")/../.." && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"${PYTHON:-python3.11}" -m venv "$scratch/venv"
"$scratch/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    -c "$checkout/constraints.txt" --upgrade pip  # twice as fast as what comes with Python 3.11
"$scratch/venv/bin/python" -m pip wheel --quiet --disable-pip-version-check --no-deps \
    --wheel-dir "$scratch/dist" "$checkout" >"$scratch/build.log" 2>&1 \
    || { cat "$scratch/build.log"; exit 1; }
"$scratch/venv/bin/python" -m pip install --quiet --no-compile --disable-pip-version-check \
    -c "$checkout/constraints.txt" "$scratch"/dist/*.whl
mkdir "$scratch/empty"
cd "$scratch/empty"
if [ "${1:-run}" = plan ]; then
    "$scratch/venv/bin/piezo-rig" plan quick_look
    "$scratch/venv/bin/piezo-rig" diagnose --help >"$scratch/said"
    echo "wheel: plans in an empty folder"
    exit
fi
"$scratch/venv/bin/piezo-rig" run quick_look | tee "$scratch/said"
tail -n 3 "$scratch/said" | while IFS=': ' read -r what path; do
    test -s "$path" || { echo "wheel: $what is missing: $path"; exit 1; }
done
echo "wheel: works in an empty folder"
