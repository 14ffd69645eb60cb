#!/usr/bin/env bash
# Build the source archive and from it the wheel, install that where no source tree is in sight, and use it.
# By default its dependencies are the ones .venv has: only livlab itself is on trial, so nothing is downloaded.
# --clean: a new environment that gets what the wheel declares and nothing else, in the versions of constraints.txt.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

python=$PWD/.venv/bin/python
room=$(mktemp -d)
trap 'rm -rf "$room"' EXIT

"$python" -m build --no-isolation --outdir "$room/dist" . >"$room/build.log" 2>&1 || {
  cat "$room/build.log" >&2
  exit 1
}
# What a clean checkout has goes into the archive, what runs and builds left behind does not.
strays=$(tar tzf "$room"/dist/*.tar.gz | grep -E '^[^/]+/(runs|\.venv|build|dist|site)/|/__pycache__/' || true)
[ -z "$strays" ] || { printf 'the source archive holds %s\n' "$strays" >&2; exit 1; }

constraints=$PWD/constraints.txt
"$python" -m venv --without-pip "$room/venv"
install=("$python" -m pip --disable-pip-version-check --python "$room/venv/bin/python" install -q)
own=$("$room/venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
if [ "${1:-}" = --clean ]; then
  "${install[@]}" --constraint "$constraints" "$room"/dist/*.whl
  "$python" -m pip --disable-pip-version-check --python "$room/venv/bin/python" check
else
  "${install[@]}" --no-deps --no-index "$room"/dist/*.whl
  # The packages of .venv by a path entry, but not its editable livlab: an entry of a .pth is searched after the
  # environment's own site-packages, and .pth files inside an added folder are not read.
  "$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))' >"$own/dependencies.pth"
fi

cd "$room"
export PATH="$room/venv/bin:$PATH"
python - "$own" <<'EOF'
import sys
from pathlib import Path

import livlab
from livlab import datasets

home = Path(livlab.__file__).resolve().parent
assert home.parent == Path(sys.argv[1]).resolve(), f"livlab was imported from {home}, not from the wheel"
assert (home / "py.typed").is_file(), "the wheel has no py.typed"
assert datasets.names(), "the wheel has no datasets"
for name in datasets.names():
    datasets.check(name)
EOF
livlab --help >/dev/null
livlab doctor
livlab data list >/dev/null
livlab run --quiet spectral-skin optics-mie-rayleigh
livlab rerun --no-report runs/optics-mie-rayleigh-*
python - <<'EOF'
import livlab

few = ("liver", "measured", [600, 650, 700])
exact = livlab.spectrum(*few, variant="parenchyma_only", solver="adding-doubling", name="exact")
walked = livlab.spectrum(*few, variant="parenchyma_only", solver="walk", accuracy=0.01, name="walked")
human = livlab.reference("liver_hsi_sellner2026", "human_reflectance_share", name="144 livers")
print(livlab.compare(exact, human))
print(livlab.compare(walked, exact))
EOF
printf 'smoke test passed: %s\n' "$(basename "$room"/dist/*.whl)"
