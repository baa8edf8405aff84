#!/bin/bash
# Run a command as root in Debian's kernel in QEMU, with this machine's root, and return its exit
# code. What it writes to files is lost; its output comes out here.
# usage: guest.sh [--modules "gs_usb vhci-hcd"] [--seconds N] -- COMMAND...
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
. "$here/job.sh"
kernel=$kernels/qemu

# An initramfs with no more than what reaches the root of this machine.
initramfs=$job/initramfs
mkdir -p "$initramfs"/{bin,modules,root}
cp "$(command -v busybox)" "$initramfs/bin/busybox"
version=$(ls "$kernel/lib/modules")
for module in virtio_pci 9pnet_virtio 9p overlay; do
    modprobe -d "$kernel" -S "$version" --show-depends "$module"
done | awk '$1 == "insmod" && !seen[$2]++ { print $2 }' >"$job/modules"
xargs cp -t "$initramfs/modules" <"$job/modules"
{
    echo '#!/bin/busybox sh'
    echo '/bin/busybox --install /bin'
    sed 's|.*/|/bin/insmod /modules/|' "$job/modules"
    nine=trans=virtio,version=9p2000.L,msize=512000,cache=loose
    echo "/bin/mount -t 9p -o ro,$nine root /root"
    echo "exec /bin/chroot /root '$here/init.sh'"
} >"$initramfs/init"
chmod +x "$initramfs/init"
(cd "$initramfs" && find . | cpio --quiet -o -H newc) >"$job/initramfs.cpio"

# busy: a processor that sleeps takes its time from the machine's clock (README.md, Time)
options="quiet panic=-1 nokaslr mitigations=off random.trust_cpu=on noautogroup busy=yes"
run qemu-system-x86_64 -machine q35,usb=off,smm=off,graphics=off \
    -accel tcg,thread=single,tb-size=512 -icount shift=0,sleep=on -cpu max,la57=off -m 1024 \
    -nodefaults -no-user-config -no-reboot -display none \
    -kernel "$kernel/linux" -initrd "$job/initramfs.cpio" \
    -append "console=ttyS0 $options job=$job kernel=$kernel" \
    -device virtio-rng-pci -serial "file:$job/console" -chardev stdio,id=output,signal=off \
    -serial chardev:output -serial "file:$job/status" \
    -virtfs local,path=/,mount_tag=root,security_model=none,readonly=on,multidevs=remap
