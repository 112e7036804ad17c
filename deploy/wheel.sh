#!/usr/bin/env bash
# Builds the files of a release for this system into target/wheels: the wheel of the Python package, and an archive of the program.
#
#   pip install --require-hashes --only-binary :all: --requirement deploy/requirements.txt
#   deploy/wheel.sh
#
# On Linux both need glibc 2.28 or later, because Zig links them; on macOS they need version 11 or later.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export MACOSX_DEPLOYMENT_TARGET=11.0
case "$(uname -sm)" in
    "Linux x86_64" | "Linux aarch64")
        target=$(uname -m)-unknown-linux-gnu platform=manylinux_2_28_$(uname -m)
        build=(cargo-zigbuild zigbuild --target "$target.2.28") ;;
    "Darwin arm64")
        target=aarch64-apple-darwin platform=macosx_11_0_arm64
        build=(cargo build --target "$target") ;;
    *)
        echo "deploy/wheel.sh: no release for $(uname -sm); 'pip install clients/python' builds one for this machine" >&2
        exit 2 ;;
esac
"${build[@]}" --release --locked --package s2mia --package python
(cd clients/python && S2MIA_BUILT=target/$target/release S2MIA_PLATFORM=$platform hatchling build --target wheel --directory ../../target/wheels)
tar --create --gzip --file "target/wheels/s2mia-$target.tar.gz" --directory "target/$target/release" s2mia
