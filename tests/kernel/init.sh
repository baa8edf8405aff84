#!/bin/bash
# The first process of a guest. Its root is that of the machine, read-only: lays a writable one over
# it, and runs the job there. The kernel's command line gives $job, $kernel and, where the processor
# shall never sleep, $busy.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root

if [ $# -eq 0 ]; then
    mount -t proc proc /proc
    grep -q overlay /proc/filesystems || insmod "$(find "$kernel/lib/modules" -name overlay.ko)"
    mount -t tmpfs tmpfs /mnt
    mkdir /mnt/{upper,work,root}
    mount -t overlay -o lowerdir=/,upperdir=/mnt/upper,workdir=/mnt/work overlay /mnt/root
    cd /mnt/root || exit
    mount -t proc proc proc
    mount -t sysfs sysfs sys
    mount -t devtmpfs devtmpfs dev
    mkdir -p dev/pts dev/shm lib/modules
    mount -t devpts -o mode=620,ptmxmode=666 devpts dev/pts
    mount -t tmpfs tmpfs dev/shm
    mount -t tmpfs tmpfs run
    mount --bind "$kernel/lib/modules" lib/modules
    exec chroot . "$0" job
fi

stty -F /dev/ttyS1 raw -echo
[ -z "${busy:-}" ] || chrt --idle 0 busybox sh -c 'while :; do :; done' &
(
    ip link set lo up
    . "$job/command"
    for module in $modules; do
        modprobe ${module//:/ } || exit
    done
    exec "${command[@]}"
) >/dev/ttyS1 2>&1 </dev/null
echo $? >/dev/ttyS2
busybox poweroff -f
sleep 60
