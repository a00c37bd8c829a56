#!/bin/sh
# Check this machine and install what the project needs. It needs a shell only, until it has found a Python that fits.
#
#   sh tools/setup.sh check EXTRA          name in one message what is missing; print the Python that fits
#   sh tools/setup.sh install EXTRA        check, then install that extra into .venv (tools/install.py)
#   sh tools/setup.sh venv FOLDER FILE   check, then install a requirements file into an environment of its own
#   sh tools/setup.sh node               check the Node that builds and tests the contracts
#   sh tools/setup.sh system             install with apt-get what the tests use and Python packages do not bring
#
# EXTRA is site, experiment or dev: each contains those before it.
# PYTHON names the interpreter to use. If it is not set, the one of .venv is kept; without .venv the newest that fits
# is taken. GOAL is the target of make that needs this, for messages.
set -eu
cd "$(dirname "$0")/.."
root=${RODEO_MACHINE:-} # tests put a folder in the place of /
PATH=$PATH:$root/usr/sbin:$root/sbin # ldconfig, for people who are not root

memory_mb=3000
node_major=18

# Measured with empty caches on two cores: what $1 costs, and the megabytes of disk to ask for.
measure() {
    case $1 in
        site) mb=1500 costs="124 packages, 280 MB to download, 0.9 GB on disk, about 2 minutes" ;;
        experiment) mb=1600 costs="134 packages, 300 MB to download, 0.9 GB on disk, about 2 minutes" ;;
        # Measured: what three test files at a time use, with their sites.
        dev) mb=3000 memory_mb=5000 costs="195 packages, 445 MB to download, 1.5 GB on disk, about 3 minutes" ;;
        venv) mb=500 costs="a few packages, 50 MB to download, 0.2 GB on disk, under a minute" ;;
    esac
}

missing=""
optional=""
packages=""
python=""
need() { missing="$missing
  - $1"; }
note() { optional="$optional
  - $1"; }
want() { packages="$packages $1"; }
say() { printf '%s\n' "$1" >&2; }

check_machine() {
    case $(uname -s) in
        Linux) ;;
        Darwin) need "Linux; this is macOS. A Linux container works:
    docker run -it --rm -v \"\$PWD\":/rodeo -w /rodeo python:3.13 make $goal" ;;
        *) need "Linux; this is $(uname -s). On Windows use WSL 2: type \`wsl --install -d Debian\` in PowerShell, and clone
    the project in there" ;;
    esac
    case $(uname -m) in
        x86_64 | amd64 | aarch64 | arm64) ;;
        *) need "a processor for which the packages are built, x86_64 or aarch64; this is $(uname -m)" ;;
    esac
    command -v make >/dev/null || need "make: apt-get install make"
}

# Every Python since 2.7 can run this.
probe='
import os, sys
version = sys.version_info[:2]
try:
    libc = os.confstr("CS_GNU_LIBC_VERSION") or "no glibc"
except (AttributeError, ValueError):
    libc = "no glibc"
why = ""
if not (3, 11) <= version <= (3, 14):
    why = "is Python %d.%d" % version
elif sys.implementation.name != "cpython":
    why = "is " + sys.implementation.name
elif sys.maxsize < 2**32:
    why = "is a 32-bit Python"
elif "t" in sys.abiflags:
    why = "is a free-threaded Python"
elif sys.platform == "linux" and ("no" in libc or tuple(map(int, libc.split()[1].split("."))) < (2, 28)):
    why = "has %s, and the packages need glibc 2.28 or newer" % libc
else:
    try:
        import ensurepip, venv
    except ImportError:
        why = "has no venv (apt-get install python%d.%d-venv)" % version
print(why)'

check_python() {
    if [ -n "${PYTHON:-}" ]; then
        set -- "$PYTHON"
    else
        set -- .venv/bin/python python3.14 python3.13 python3.12 python3.11 python3
    fi
    unfit=""
    for candidate; do
        path=$(command -v "$candidate") || continue
        # A shim of pyenv is there for each Python that some folder uses, and does not run elsewhere.
        why=$("$path" -c "$probe" 2>/dev/null) || why="does not run"
        if [ -z "$why" ]; then
            python=$path
            return
        fi
        unfit="${unfit:+$unfit; }$candidate $why"
    done
    need "Python 3.11, 3.12, 3.13 or 3.14 with venv. Tried: ${unfit:-${PYTHON:-python3} is not there}.
    On Debian 12 and 13 and Ubuntu 24.04: apt-get install python3 python3-venv
    Elsewhere install one of them, for example with \`uv python install 3.13\`, and name it:
    make $goal PYTHON=/path/to/python3.13"
}

check_room() { # $1 megabytes of disk
    free=$(df -Pk . | awk 'NR == 2 {print int($4 / 1024)}')
    [ "$free" -ge "$1" ] || need "disk: $1 MB; $free MB are free here"
    memory=$(awk '
        FILENAME ~ /meminfo$/ && /^MemTotal:/ {total = $2 / 1024}
        FILENAME ~ /memory.max$/ && /^[0-9]/ {limit = $1 / 1048576}
        END {print int(limit && limit < total ? limit : total)}' \
        $(ls "$root/proc/meminfo" "$root/sys/fs/cgroup/memory.max" 2>/dev/null) </dev/null)
    [ "$memory" -ge "$memory_mb" ] || need "memory: $memory_mb MB; this machine has $memory MB"
}

has_egl() { ldconfig -p 2>/dev/null | grep -q 'libEGL\.so\.1'; }
has_node() {
    command -v npm >/dev/null && major=$(node -p 'process.versions.node.split(".")[0]' 2>/dev/null) \
        && [ "$major" -ge "$node_major" ]
}
has_postgresql() { command -v initdb >/dev/null || ls "$root"/usr/lib/postgresql/*/bin/initdb >/dev/null 2>&1; }
has_chromium() { command -v chromium-headless-shell || command -v chromium || command -v chromium-browser || command -v google-chrome; } >/dev/null
has_ros1() { [ -x "$root/usr/bin/rosmaster" ] && [ -e .venv-noetic/whole ]; }
has_systemd() { command -v systemd-analyze >/dev/null; }
has_rosidl() { "$root/usr/bin/python3" -c 'import em, rosidl_adapter' >/dev/null 2>&1; }

check_optional() { # $1 site or dev
    has_egl || note "libEGL, for pictures: without it the bin's camera shows checked-in ones (apt-get install libegl1, 40 MB)"
    [ "$1" = dev ] || return 0
    has_node || note "Node $node_major or newer with npm: without it the tests of the contracts are skipped"
    has_postgresql || note "PostgreSQL: without it the tests of the bridge's index in it are skipped"
    has_chromium || note "Chromium: without it the tests of the console's pages are skipped"
    has_rosidl || note "rosidl-tools: without it the grammar of the ROS 2 interfaces is not tested"
    has_systemd || note "systemd-analyze: without it the units of \`rodeo deploy systemd\` are not verified"
    has_ros1 || note "ROS 1: without it the tests of the relay for Noetic are skipped"
    [ -z "$optional" ] || note "\`make system\` installs these with apt-get"
}

check() { # $1 site, dev or venv; sets python
    measure "$1"
    check_machine
    if [ "$(uname -s)" = Linux ]; then
        check_python
        check_room "$mb"
        [ "$1" = venv ] || check_optional "$1"
    fi
    if [ -n "$missing" ]; then
        say "\`make $goal\` cannot run here. It needs:$missing${optional:+
It would also use:$optional}"
        exit 1
    fi
    doing="To install: $costs"
    [ ! -e .venv/whole ] || [ "$python" != .venv/bin/python ] || doing="Bringing .venv up to date"
    say "make $goal: $("$python" -V) ($python) fits. $doing.${optional:+
Not here, and not needed:$optional}"
}

ros1="python3-venv python3-rospy python3-rosmaster python3-actionlib python3-actionlib-msgs python3-diagnostic-msgs
    python3-geometry-msgs python3-nav-msgs python3-sensor-msgs python3-std-srvs python3-tf2-msgs python3-trajectory-msgs
    ros-actionlib-msgs ros-nav-msgs ros-sensor-msgs ros-trajectory-msgs"

# What a Noetic robot has: the system's rospy, and an old Zenoh client.
noetic() {
    say "  .venv-noetic: $(tr '\n' ' ' <tests/noetic_robot/requirements.txt)"
    "$root/usr/bin/python3" -m venv --system-site-packages .venv-noetic \
        && .venv-noetic/bin/python -m pip install --quiet --requirement tests/noetic_robot/requirements.txt \
        && : >.venv-noetic/whole
}

# Debian's names. Without recommended packages: those of npm bring a compiler.
system() {
    has_egl || want libegl1
    command -v node >/dev/null || want nodejs
    command -v npm >/dev/null || want npm
    has_postgresql || want postgresql
    has_chromium || want chromium-headless-shell
    has_rosidl || { want rosidl-tools; want python3-empy; }
    has_systemd || want systemd
    has_ros1 || for package in $ros1; do want "$package"; done
    if [ -n "$packages" ]; then
        if ! command -v apt-get >/dev/null; then
            say "There is no apt-get here. Install with this system's own package manager (Debian's names):$packages"
            exit 1
        fi
        sudo=""
        if [ "$(id -u)" != 0 ]; then
            command -v sudo >/dev/null || { say "Type as root: apt-get install$packages"; exit 1; }
            sudo=sudo
        fi
        say "apt-get install$packages"
        $sudo apt-get update -qq || say "apt-get update failed; trying with the package lists that are here"
        for package in $packages; do
            # shellcheck disable=SC2086
            $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends $package >/dev/null \
                && say "  $package: installed" || say "  $package: apt-get cannot install it"
        done
    fi
    [ ! -x "$root/usr/bin/rosmaster" ] || has_ros1 || noetic || say "  .venv-noetic: could not be made"
    has_egl || need "libEGL"
    has_node || need "Node $node_major or newer with npm"
    has_postgresql || need "PostgreSQL"
    has_chromium || need "Chromium (on Ubuntu: Google Chrome's own package)"
    has_rosidl || say "rosidl-tools is missing: the grammar of the ROS 2 interfaces is not tested."
    has_systemd || say "systemd-analyze is missing: units are not verified."
    has_ros1 || say "ROS 1 is missing: the relay for Noetic is not tested."
    if [ -n "$missing" ]; then
        say "Still missing; their tests are skipped:$missing"
        exit 1
    fi
    say "libEGL, Node, PostgreSQL and Chromium are here."
}

goal=${GOAL:-demo}
case ${1:-} in
    check) check "$2" && printf '%s\n' "$python" ;;
    install) check "$2" && exec "$python" tools/install.py --extra "$2" ;;
    venv) check venv && exec "$python" tools/install.py --folder "$2" --requirement "$3" ;;
    node) has_node || {
        say "\`make $goal\` needs Node $node_major or newer with npm: make system"
        exit 1
    } ;;
    system) system ;;
    *) sed -n '2,/^set /s/^# \{0,1\}//p' "$0" >&2 && exit 2 ;;
esac
