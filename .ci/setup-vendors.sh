#!/usr/bin/env bash
# Installs the real DDS software that tests/real holds keystores against (Debian or Ubuntu), what its probes need, and the
# browser that tests of reports run.
# Where that is not possible it says why. The tests then skip, visibly, what they lack; with KEYMINT_REQUIRE_VENDORS=1
# they fail, and so does this.
set -euo pipefail
cd "$(dirname "$0")/.."

packages=(
    libddsc0debian cyclonedds-dev                # Cyclone DDS and its security plugins
    libfastrtps-dev libfastcdr-dev               # Fast DDS, with security compiled in
    gcc g++                                      # the probes of the real transports
    openssl strace                               # what other tests run
    chromium chromium-driver fonts-dejavu-core   # what the tests of pictures and reports look at them with
)
if .ci/apt-install "${packages[@]}"; then exit 0; fi
echo "setup-vendors: some of ${packages[*]} cannot be installed (see above): tests on real software will skip" >&2
[ "${KEYMINT_REQUIRE_VENDORS:-}" != 1 ]
