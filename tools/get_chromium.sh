#!/usr/bin/env bash
# See that there is a chromium for the tests of the studio's page: Debian's own package, by apt, where this is root.
# Never fails: the tests then say in one line what is missing, and nothing else of nacre needs a browser of its own.
set -uo pipefail
cd "$(dirname "$0")/.."

for there in chromium chromium-browser google-chrome; do
    if command -v "$there" >/dev/null 2>&1; then exit 0; fi
done
advice="the tests of the studio's page need it (apt-get install chromium)"
if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null 2>&1; then
    echo "setup: there is no chromium; $advice" >&2
    exit 0
fi
echo "setup: fetching chromium for the tests of the studio's page"
log=$(mktemp)
trap 'rm -f "$log"' EXIT
for attempt in 1 2 3; do
    if DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends chromium >"$log" 2>&1; then
        exit 0
    fi
    apt-get -q update >/dev/null 2>&1 || sleep 5 # no package lists yet, or old ones
done
echo "setup: apt could not install chromium; $advice: $(grep -m1 '^E:' "$log")" >&2
exit 0
