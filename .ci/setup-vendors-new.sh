#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Unpacks newer versions of Fast DDS and Cyclone DDS from Debian into this user's cache, each with the libraries and the
# loader that it needs. Nothing is installed, and apt's own lists stay as they are. Where that fails (not Debian, offline,
# another architecture), one line says why, and the tests that need them skip. With KEYMINT_REQUIRE_NEW_VENDORS=1 they
# fail, and so does this script.
# Debian's signatures are checked whatever the machine's settings are. Versions are pinned, up to rebuilds by Debian.
set -euo pipefail

vendors=( # folder, suite, packages of headers and libraries, packages of libraries alone: with all that they depend on
    "fastdds-3.1.2 trixie libfastdds-dev=3.1.2*,libfastcdr-dev libfastdds3.1=3.1.2*"
    "fastdds-3.3.0 sid libfastdds-dev=3.3.0*,libfastcdr-dev libfastdds3.3=3.3.0*"
    "cyclonedds-0.10.5 trixie cyclonedds-dev=0.10.5* libddsc0t64=0.10.5*"
)
keyring=/usr/share/keyrings/debian-archive-keyring.gpg
case ${XDG_CACHE_HOME:-} in /*) cache=$XDG_CACHE_HOME ;; *) cache=$HOME/.cache ;; esac
cache=$cache/keymint/vendors
# Beside the result, so that a folder appears there complete or not at all, whenever this is killed.
(umask 077 && mkdir -p "$cache")
find "$cache" -maxdepth 1 -name 'unpacking.*' -mmin +60 -exec rm -rf {} + # of runs that were killed
work=$(mktemp -d "$cache/unpacking.XXXXXX")
trap 'rm -rf "$work"' EXIT

# apt with a sources list, settings and folders of its own, for one suite. The machine's settings (a proxy) apply first.
prepare() {
    mkdir -p "$work/$1/lists/partial" "$work/$1/archives/partial"
    : >"$work/$1/status"
    echo "deb [signed-by=$keyring] $mirror $1 main" >"$work/$1/sources.list"
    cat >"$work/$1/apt.conf" <<EOF
#clear APT::Update;
Dir::State "$work/$1"; Dir::State::lists "lists"; Dir::State::status "$work/$1/status"; Dir::Cache "$work/$1";
Dir::Etc::SourceList "$work/$1/sources.list"; Dir::Etc::SourceParts "/dev/null"; Dir::Etc::PreferencesParts "/dev/null";
Acquire::AllowInsecureRepositories "false"; APT::Get::AllowUnauthenticated "false"; Acquire::http::Timeout "20";
APT::Update::Error-Mode "any"; Debug::NoLocking "true";
EOF
    apt-get -qq -c "$work/$1/apt.conf" update
}

unpack() {
    local folder=$1 suite=$2 headers=${3//,/ } libraries=$4 debs=$work/debs-$1 root=$work/$1 needed
    [ -d "$work/$suite" ] || prepare "$suite"
    mkdir "$debs" "$root"
    needed=$(apt-get -c "$work/$suite/apt.conf" install --simulate --no-install-recommends "$libraries" |
        awk '$1 == "Inst" { print $2 "=" substr($3, 2) }')
    # shellcheck disable=SC2086 - lists of words
    (set -f && cd "$debs" && apt-get -qq -c "$work/$suite/apt.conf" download $needed $headers)
    for deb in "$debs"/*.deb; do dpkg-deb -x "$deb" "$root"; done
    rm -rf "$root/usr/share"
    mv -T "$root" "$cache/$folder"
}

missing=()
release=$(. /etc/os-release && echo "$ID ${VERSION_CODENAME:-}")
mirror=$(apt-get update --print-uris 2>/dev/null |
    sed -n "s|^'\(.*\)/dists/${release#* }/InRelease'.*|\1|p" | head -n 1) || mirror=
for vendor in "${vendors[@]}"; do
    read -r folder suite headers libraries <<<"$vendor"
    if [ -d "$cache/$folder" ]; then continue; fi
    if [ "${release% *}" != debian ] || [ -z "$mirror" ]; then
        missing+=("$folder (apt has no source of Debian's releases)")
        continue
    fi
    set +e # in a condition, an error within the function would not end it
    (set -e && unpack "$folder" "$suite" "$headers" "$libraries") >"$work/log" 2>&1
    code=$?
    set -e
    [ "$code" -eq 0 ] || missing+=("$folder ($(grep '^E:' "$work/log" || tail -n 1 "$work/log"))")
done
if [ "${#missing[@]}" -eq 0 ]; then exit 0; fi
echo "setup-vendors-new: tests skip for lack of ${missing[*]//$'\n'/; }" >&2
[ "${KEYMINT_REQUIRE_NEW_VENDORS:-}" != 1 ]
