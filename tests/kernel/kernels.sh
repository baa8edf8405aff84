#!/bin/sh
# Fetch Debian's kernels into DIRECTORY, unless they are there: linux-image for QEMU,
# user-mode-linux for a process. Nothing is installed; needs recent lists of apt-get update.
# usage: kernels.sh DIRECTORY
set -eu
PATH=$PATH:/usr/sbin:/sbin
directory=$1
[ -e "$directory/complete" ] && exit
mkdir -p "$directory"
directory=$(cd "$directory" && pwd)
work=$(mktemp -d "$directory/fetch.XXXXXX")
trap 'rm -rf "$work"' EXIT
cd "$work"

image=$(apt-cache depends linux-image-amd64 | sed -n 's/.*Depends: \(linux-image-.*\)/\1/p')
[ -n "$image" ] || { echo "kernels.sh: apt knows no linux-image-amd64" >&2; exit 1; }
apt-get -qq -o APT::Sandbox::User=root download "$image" user-mode-linux
dpkg-deb --fsys-tarfile "$image"_*.deb | tar -x --exclude='*/drivers/gpu' \
    --exclude='*/drivers/media' --exclude='*/drivers/infiniband' \
    --exclude='*/drivers/net/ethernet' --exclude='*/drivers/net/wireless'
dpkg-deb --fsys-tarfile user-mode-linux_*.deb | tar -x

mkdir -p qemu/lib uml/lib
mv boot/vmlinuz-* qemu/linux
mv lib/modules qemu/lib
mv usr/bin/linux.uml uml/linux
mv usr/lib/uml/modules uml/lib
depmod -b qemu "$(ls qemu/lib/modules)"

rm -rf "$directory/qemu" "$directory/uml"
mv qemu uml "$directory"
touch "$directory/complete"
