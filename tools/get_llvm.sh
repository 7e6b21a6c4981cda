#!/usr/bin/env bash
# See that there is a libLLVM that Dr.Jit 1.5 can work with. On Linux x86-64 pip brought it as a wheel. On another Linux
# Debian's own packages are fetched, without root, and unpacked into .llvm in the project's root, which nacre.render
# looks into. LLVM 14 is refused by Dr.Jit, 15 and 16 abort the whole process. Never fails: everything but rendering
# works without, and `nacre doctor` explains.
set -uo pipefail
cd "$(dirname "$0")/.."
root=$PWD
python=$root/.venv/bin/python

works() { "$python" -m nacre.device.llvm >/dev/null 2>&1; }

mkdir -p .llvm
if works; then touch .llvm/ok; exit 0; fi
system="$(uname -s) $(uname -m)"
if [ "$system" = "Linux x86_64" ] || [ "${system%% *}" != Linux ] ||
    ! command -v apt-get >/dev/null 2>&1 || ! command -v dpkg >/dev/null 2>&1; then
    echo "setup: no libLLVM that Mitsuba can use; rendering will be slow. $("$python" -m nacre.device.llvm --advice)" >&2
    exit 0
fi
echo "setup: fetching libLLVM for Mitsuba"
lists=$root/.llvm/lists
options=()
if ! apt-cache show libllvm19 >/dev/null 2>&1; then
    # no package lists and maybe no root: keep lists of our own beside the library
    mkdir -p "$lists/partial" .llvm/cache/archives/partial
    options=(-o "Dir::State::Lists=$lists" -o "Dir::Cache=$root/.llvm/cache" -o "APT::Sandbox::User=$(id -un)")
    apt-get "${options[@]}" -q update >.llvm/apt.log 2>&1 || true
fi
work=$(mktemp -d)
trap 'rm -rf "$work" "$root/.llvm/lists" "$root/.llvm/cache"' EXIT
for version in 19 20 21 22 18 17; do
    (
        cd "$work" && rm -f ./*.deb
        apt-get "${options[@]}" -o "APT::Sandbox::User=$(id -un)" -q download "libllvm$version" >>"$root/.llvm/apt.log" 2>&1
    ) || continue
    # what libLLVM links to and a bare container may lack
    for dependency in libz3-4 libedit2 libbsd0 libmd0 libxml2 libzstd1 libffi8 libtinfo6 libicu72 libicu74 libicu76; do
        (cd "$work" && apt-get "${options[@]}" -o "APT::Sandbox::User=$(id -un)" -q download "$dependency" >>"$root/.llvm/apt.log" 2>&1) || true
    done
    for package in "$work"/*.deb; do dpkg -x "$package" .llvm; done
    if works; then touch .llvm/ok; exit 0; fi
done
echo "setup: no libLLVM that Mitsuba can use was found; rendering will be slow (see: nacre doctor)" >&2
exit 0
