#!/bin/sh
# First process of the user-mode kernel: brings vcan0 up, runs the script $HIL_GUEST_COMMAND, powers off.
# The root is the host's own file system (hostfs), so the same virtual environment runs here.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t tmpfs tmpfs /run
mkdir -p /dev/shm && mount -t tmpfs tmpfs /dev/shm
modules=$(echo /usr/lib/uml/modules/*/kernel)
for module in net/can/can net/can/can-raw net/can/can-bcm drivers/net/can/dev/can-dev drivers/net/can/vcan; do
    insmod "$modules/$module.ko"
done
ip link add dev vcan0 type vcan
ip link set up vcan0
ip link set up lo
sh "$HIL_GUEST_COMMAND"
echo o > /proc/sysrq-trigger
sleep 60
