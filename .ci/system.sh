#!/bin/sh
# The tests drive a real terminal, real network namespaces and a machine with Bluetooth, systemd checks the units, and
# dpkg installs the Debian package in a bare system. Without root, tests that lack a tool are skipped.
packages="tmux mosh dtach qemu-system-x86 iproute2 nftables systemd debootstrap"
for tool in tmux mosh-server dtach qemu-system-x86_64 tc nft systemd-analyze debootstrap; do
  command -v "$tool" > /dev/null || missing=1
done
[ -n "$missing" ] || exit 0
[ "$(id -u)" = 0 ] && command -v apt-get > /dev/null && apt-get update -qq \
  && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $packages > /dev/null \
  || echo "some tests will be skipped, for want of tools (apt install $packages)"
