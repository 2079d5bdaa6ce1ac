# Sourced by the scripts that check flowservo with other programs: finds the program, and installs what a check needs.
#
# A check whose requirements are missing fails with exit code 3. CI=true installs missing Debian packages first, when run as root.
# FLOWSERVO_SKIP_MISSING=1 reports the check as skipped and succeeds; CI=true ignores it.

repository="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
target="${CARGO_TARGET_DIR:-$repository/target}"

# Compiled Python modules go here, not beside the sources.
export PYTHONDONTWRITEBYTECODE= PYTHONPYCACHEPREFIX="$target/pycache"

# missing MESSAGE: ends the check because a requirement is missing.
missing() {
    if [ "${FLOWSERVO_SKIP_MISSING:-0}" = 1 ] && [ "${CI:-false}" != true ]; then
        echo "skipped: $1"
        exit 0
    fi
    echo "$0: $1" >&2
    [ "${CI:-false}" = true ] || echo "FLOWSERVO_SKIP_MISSING=1 skips checks that cannot run here" >&2
    exit 3
}

# find_flowservo [PROGRAM]: sets `flowservo` to the program, by default the most recent build.
find_flowservo() {
    flowservo="${1:-$(ls -t "$target"/{debug,release}/flowservo 2>/dev/null | head -n 1)}" || true
    [ -x "$flowservo" ] || { echo "$0: flowservo is not built; run: cargo build" >&2; exit 1; }
    flowservo="$(realpath "$flowservo")"
}

# require PROGRAM...: each is in the Debian package of the same name.
require() {
    local program absent=()
    for program; do
        command -v "$program" >/dev/null || absent+=("$program")
    done
    [ ${#absent[@]} -gt 0 ] || return 0
    install_packages "${absent[@]}" || missing "not installed: ${absent[*]} (Debian, Ubuntu: apt-get install ${absent[*]})"
    hash -r
    for program in "${absent[@]}"; do
        command -v "$program" >/dev/null || missing "$program is not in PATH after its installation"
    done
}

# require_python: sets `python` to an interpreter that can make virtual environments.
require_python() {
    find_python || { install_packages python3-venv && find_python; } \
        || missing "no Python 3.11 or newer with venv (Debian, Ubuntu: apt-get install python3-venv)"
}

find_python() {
    for python in python3 python3.{14,13,12,11} /usr/bin/python3; do
        "$python" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && return
    done
}

# install_packages PACKAGE...: installs Debian packages in CI; fails everywhere else.
install_packages() {
    [ "${CI:-false}" = true ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null || return 1
    echo "installing $*"
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y -o DPkg::Lock::Timeout=120 --no-install-recommends "$@" >/dev/null
}

# python_environment NAME REQUIREMENTS: sets `python` to that of the virtual environment target/NAME with the packages of the
# file REQUIREMENTS. Creates it if it does not exist or if the file has changed.
python_environment() {
    local folder="$target/$1"
    if ! cmp -s "$2" "$folder/requirements.txt"; then
        require_python
        mkdir -p "$folder"
        "$python" -m venv --clear "$folder"
        # Modules are compiled when they are first imported: most never are.
        "$folder/bin/pip" install --quiet --disable-pip-version-check --no-compile --requirement "$2" >"$folder/pip.log" 2>&1 \
            || { tail -n 5 "$folder/pip.log" >&2; missing "the packages of $2 cannot be installed; see $folder/pip.log"; }
        cp "$2" "$folder/requirements.txt"
    fi
    python="$folder/bin/python"
}
