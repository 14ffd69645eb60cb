#!/usr/bin/env bash
# Put everything livlab needs into .venv, and see that Dr.Jit has a libLLVM it can use.
# Idempotent: a second call only looks whether everything is still there.
#   PYTHON=...           the interpreter to use (3.11 or newer)
#   LIVLAB_NO_LLVM=1     go on without a usable libLLVM: what needs Dr.Jit will not run
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly VENV=.venv
readonly STAMP=$VENV/.livlab-setup
readonly NEEDED_KIB=$((3 * 1024 * 1024))
readonly LIBLLVM_PACKAGES="libllvm19 libllvm20 libllvm18 libllvm17t64 libllvm17 libllvm21"

say() { printf '%s\n' "setup: $*"; }
fail() {
  printf '%s\n' "setup: error: $1" >&2
  [ $# -lt 2 ] || printf '%s\n' "setup: remedy: $2" >&2
  exit 1
}
have() { command -v "$1" >/dev/null 2>&1; }
is_root() { [ "$(id -u)" -eq 0 ]; }
is_interactive() { [ -t 0 ] && [ -t 1 ]; }
new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; }

fingerprint() {
  local sum="cksum"
  if have sha256sum; then sum="sha256sum"; elif have shasum; then sum="shasum -a 256"; fi
  { pwd -P; cat pyproject.toml constraints.txt scripts/setup.sh; } | $sum | cut -d ' ' -f 1
}

# --- apt, with or without root ------------------------------------------------------------------------------------

apt_get() { # as root, quietly, and without hanging on a dead network
  local prefix=""
  is_root || prefix="sudo"
  DEBIAN_FRONTEND=noninteractive $prefix apt-get -qq -y \
    -o Acquire::Retries=1 -o Acquire::http::Timeout=15 -o Acquire::https::Timeout=15 -o DPkg::Lock::Timeout=60 "$@"
}

apt_offers() {
  local policy
  policy=$(apt-cache policy "$1" 2>/dev/null) || return 1
  [[ $policy == *"Candidate: "* && $policy != *"Candidate: (none)"* ]]
}

apt_first_offered() { # the first of the given packages that apt can install
  local package
  for package in "$@"; do
    if apt_offers "$package"; then printf '%s' "$package"; return; fi
  done
  return 1
}

may_apt() { # root just does it, sudo asks, everybody else is told the command
  have apt-get || return 1
  is_root && return 0
  have sudo && is_interactive || return 1
  local answer
  read -r -p "setup: install $1 with sudo apt-get? [Y/n] " answer
  case $answer in '' | [Yy]*) return 0 ;; *) return 1 ;; esac
}

# --- Python -------------------------------------------------------------------------------------------------------

find_python() {
  local name
  if [ -n "${PYTHON:-}" ]; then
    if new_enough "$PYTHON"; then printf '%s' "$PYTHON"; return; fi
    return 1
  fi
  for name in python3 python3.12 python3.11 python3.13 python3.14; do # the default first: its venv module is the likeliest
    if have "$name" && new_enough "$name"; then printf '%s' "$name"; return; fi
  done
  return 1
}

require_python() {
  local seen
  if ! python=$(find_python); then
    if [ -z "${PYTHON:-}" ] && ! have python3 && have apt-get && is_root; then
      say "installing Python"
      apt_get update && apt_get install python3 python3-venv || fail "apt could not install Python."
      python=$(find_python) || fail "this system's own Python is older than 3.11." "install Python 3.11 or newer"
    else
      seen=$("${PYTHON:-python3}" -V 2>&1) || seen="none"
      fail "Python 3.11 or newer is needed, found: ${seen##*$'\n'}." \
        "install it (Debian, Ubuntu: sudo apt-get install -y python3 python3-venv; macOS: brew install python@3.12) or call PYTHON=/path/to/python make setup"
    fi
  fi
  if ! "$python" -c 'import venv, ensurepip' >/dev/null 2>&1; then
    local package="python3-venv"
    [ "$python" = python3 ] || package="$(basename "$python")-venv"
    if may_apt "$package"; then
      say "installing $package"
      apt_offers "$package" || apt_get update || true
      apt_get install "$package" || fail "apt could not install $package."
    fi
    "$python" -c 'import venv, ensurepip' >/dev/null 2>&1 ||
      fail "$python cannot make virtual environments." "sudo apt-get install -y $package"
  fi
}

# --- the virtual environment --------------------------------------------------------------------------------------

require_space() {
  local free
  free=$(df -Pk . | awk 'NR == 2 { print $4 }')
  [ "$free" -ge $NEEDED_KIB ] ||
    fail "$((free / 1024)) MiB free here, the packages need $((NEEDED_KIB / 1024 / 1024)) GiB." "make room, or clone to another disk"
}

require_index() { # one small package, few tries: a dead network should say so in seconds, not after pip's long patience
  "$VENV/bin/python" -m pip --retries 1 --timeout 10 install -q --dry-run --no-deps --ignore-installed --no-input \
    --disable-pip-version-check iniconfig >"$VENV/index.log" 2>&1 || {
    sed -n 's/^\(ERROR\|WARNING\): /setup: pip: /p' "$VENV/index.log" | cut -c 1-240 | tail -n 2 >&2
    fail "pip reaches no package index." "check the network, HTTPS_PROXY, and pip's settings (pip config list)"
  }
}

install_packages() {
  local pip="$VENV/bin/python -m pip --disable-pip-version-check --no-input" quiet=""
  [ -t 1 ] || quiet="-q"
  rm -f "$STAMP"
  if [ ! -x $VENV/bin/python ] || ! new_enough $VENV/bin/python || ! $pip --version >/dev/null 2>&1; then
    say "making $VENV with $("$python" -V 2>&1)"
    "$python" -m venv --clear $VENV || fail "$python could not make $VENV."
  fi
  require_index
  say "installing packages into $VENV (a minute or two, 0.5 GB to download at first)"
  $pip install -q -c constraints.txt pip || fail "pip could not bring itself to the pinned version."
  $pip install $quiet -c constraints.txt --build-constraint constraints.txt -e '.[dev]' ||
    fail "pip could not install the packages; its own message is above." "mend that and call make setup again"
}

# --- libLLVM ------------------------------------------------------------------------------------------------------

llvm_trouble() { # prints nothing and succeeds when Dr.Jit has a library it can use
  local status=0
  "$VENV/bin/python" -c '
import sys
from livlab.errors import LivlabError
from livlab.machine.llvm import choose_libllvm
try:
    choose_libllvm()
except LivlabError as error:
    print(error.message, error.remedy, sep="\n")
    sys.exit(3)
' 2>&1 || status=$?
  return $status
}

require_llvm() { # Dr.Jit itself needs libatomic, which a minimal Debian or Ubuntu lacks
  local trouble package command status=0
  trouble=$(llvm_trouble) || status=$?
  [ $status -ne 0 ] || return 0
  [ $status -eq 3 ] || fail "$VENV does not work: ${trouble##*$'\n'}" "rm -rf $VENV and call make setup again"
  if [ -n "${DRJIT_LIBLLVM_PATH:-}" ]; then # the user's own choice is not ours to mend
    without_llvm "$trouble"
    return
  fi
  if have apt-get; then
    # shellcheck disable=SC2086
    if ! package=$(apt_first_offered $LIBLLVM_PACKAGES) && is_root; then
      apt_get update || true
      package=$(apt_first_offered $LIBLLVM_PACKAGES) || package=""
    fi
    command="sudo apt-get install -y libatomic1 ${package:-libllvm19}"
    if [ -n "$package" ] && may_apt "libatomic1 $package"; then
      say "installing libatomic1 $package"
      apt_get install libatomic1 "$package" || { apt_get update && apt_get install libatomic1 "$package"; } ||
        say "apt could not install $package"
    fi
  elif [ "$(uname -s)" = Darwin ]; then
    command="brew install llvm"
    if have brew; then
      say "installing LLVM with brew"
      brew install llvm || say "brew could not install llvm"
    fi
  else
    command="install LLVM 17 or newer (its shared library)"
  fi
  trouble=$(llvm_trouble) || without_llvm "$trouble" "$command"
}

without_llvm() {
  if [ "${LIVLAB_NO_LLVM:-0}" = 1 ]; then
    say "going on without a usable libLLVM: ${1%%$'\n'*}"
  else
    fail "${1%%$'\n'*}" "${2:-${1##*$'\n'}}"
  fi
}

# --- what only some tests need ------------------------------------------------------------------------------------

offer_browser() { # Ubuntu's package of this name is only a pointer to a snap
  have chromium && return
  if have apt-get && is_root && grep -qs '^ID=debian' /etc/os-release; then
    say "installing chromium for the browser tests"
    apt_offers chromium || apt_get update || true
    apt_get install --no-install-recommends chromium fonts-dejavu-core >/dev/null 2>&1 ||
       say "no chromium: the browser tests will be skipped"
  else
    say "no chromium found: the browser tests will be skipped"
  fi
}

# --- all of it ----------------------------------------------------------------------------------------------------

mark=$(fingerprint)
if [ ! -x $VENV/bin/livlab ] || [ "$(cat $STAMP 2>/dev/null)" != "$mark" ]; then
  require_python
  require_space
  install_packages
  printf '%s\n' "$mark" >"$STAMP"
  offer_browser
  require_llvm
  say "done"
else
  require_llvm
fi
