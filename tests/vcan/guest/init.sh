#!/bin/sh
# Inside the guest kernel, as its first process (user-mode Linux) or from virtme-ng's (QEMU): brings vcan0 up and
# runs the script $HIL_GUEST_COMMAND. The root is the host's own file system, read-only, so that the same virtual
# environment runs here. Written to are the results, $HIL_GUEST_OUT, and the project: numba looks for its cache beside
# the source, and only where it could write one.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/run/home LANG=C.UTF-8
export TMPDIR=/run/tmp HIL_GUEST_OUT HIL_GUEST_COMMAND
if [ "$HIL_GUEST_KIND" = uml ]; then
    mount -t proc proc /proc
    mount -t sysfs sys /sys
    mount -t tmpfs tmpfs /run
    mkdir -p /dev/shm && mount -t tmpfs tmpfs /dev/shm
    for folder in "$HIL_GUEST_PROJECT" "$HIL_GUEST_OUT"; do mount -t hostfs none "$folder" -o "$folder"; done
fi
mkdir -p "$HOME" "$TMPDIR"

# By file and in this order, so that no index of dependencies is needed; what is absent or built in is left out.
load() {
    module=$1
    shift
    for file in "$HIL_GUEST_MODULES"/kernel/$module.ko* "$HIL_GUEST_MODULES"/*/kernel/$module.ko*; do
        [ ! -e "$file" ] || insmod "$file" "$@" 2>> "$HIL_GUEST_OUT/insmod.log"
    done
}
for name in can can-raw can-bcm can-gw; do load net/can/$name; done
load drivers/net/can/dev/can-dev
load drivers/net/can/vcan ${HIL_GUEST_VCAN_ECHO:+echo=1}
load net/sched/sch_netem
ip link set up lo
ip link add dev vcan0 type vcan && ip link set up vcan0

sh "$HIL_GUEST_COMMAND" > "$HIL_GUEST_OUT/command.log" 2>&1
echo $? > "$HIL_GUEST_OUT/exit-code"
if [ "$HIL_GUEST_KIND" = uml ]; then
    umount "$HIL_GUEST_OUT"
    echo o > /proc/sysrq-trigger
    sleep 60
fi
