# Sourced by the scripts that ask Python: a virtual environment of their own under target/.

# Says why nothing was checked, and ends the script: with success, unless the first argument is 1.
skip() {
    echo "skipped: $2"
    [ "$1" != 1 ]
    exit
}

# environment FOLDER REQUIREMENTS REQUIRED: installs into FOLDER what the file REQUIREMENTS names, unless it is there. Where there is
# no Python 3.11 or newer, or no package index, it skips.
environment() {
    cmp -s "$2" "$1/requirements.txt" && return
    python3 -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
        || skip "$3" "no Python 3.11 or newer with venv"
    mkdir -p "$1"
    python3 -m venv --clear "$1"
    "$1/bin/pip" install --quiet --disable-pip-version-check --retries 1 --timeout 20 --requirement "$2" \
        >"$1/pip.log" 2>&1 || skip "$3" "the packages cannot be installed; $1/pip.log says why"
    cp "$2" "$1/requirements.txt"
}
