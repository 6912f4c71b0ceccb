#!/bin/sh
# boot.sh FOLDER PROGRAM UNITS: a systemd of its own, in namespaces, over an overlay of this machine's root, with the unit
# and a camera in software. FOLDER/etc is its /etc/pitchd. Says `ready` before systemd begins; nothing outside is changed
# but the control group FOLDER/cgroup names, which the caller removes.
set -eu
folder=$1 program=$2 units=$3
if [ "${4-}" = "" ]; then
    groups=$(findmnt -n -t cgroup2 -o TARGET | head -1)
    mkdir "$groups/pitchd-lab-$$"
    echo "$groups/pitchd-lab-$$" > "$folder/cgroup"
    echo $$ > "$groups/pitchd-lab-$$/cgroup.procs"
    exec unshare --pid --fork --kill-child --mount --net --uts --ipc --cgroup "$0" "$folder" "$program" "$units" inside
fi
mkdir "$folder/root" "$folder/layer"
mount -t tmpfs tmpfs "$folder/layer"
mkdir "$folder/layer/upper" "$folder/layer/work"
root=$folder/root
mount -t overlay overlay -o "lowerdir=/,upperdir=$folder/layer/upper,workdir=$folder/layer/work" "$root"
mount -t proc proc "$root/proc"
mount -t sysfs sysfs "$root/sys"
mount -t cgroup2 cgroup2 "$root/sys/fs/cgroup"
mount -t tmpfs tmpfs "$root/run"
mount -t tmpfs tmpfs "$root/tmp"
mount --bind /dev "$root/dev"
ip link set lo up
# Nothing of this machine's own services: they would set its clock, its kernel, its devices.
rm -rf "$root"/lib/systemd/system/*.target.wants "$root"/usr/lib/systemd/system/*.target.wants "$root"/etc/systemd/system/*
: > "$root/usr/bin/pitchd"
mount --bind "$program" "$root/usr/bin/pitchd"
install -D -m 644 "$units/pitchd.service" "$root/usr/lib/systemd/system/pitchd.service"
install -D -m 644 "$units/pitchd.sysusers.conf" "$root/usr/lib/sysusers.d/pitchd.conf"
mkdir -p "$root/etc/pitchd" "$root/etc/systemd/system/pitchd.service.d"
cp "$folder"/etc/* "$root/etc/pitchd/"
chroot "$root" systemd-sysusers pitchd.conf 2>/dev/null
cat > "$root/etc/systemd/system/camera.service" <<EOF
[Service]
ExecStart=/usr/bin/pitchd emulate pattern:320x160 --rate 40 --camera first --address 127.0.0.9
EOF
# The same unit with less patience.
cat > "$root/etc/systemd/system/pitchd.service.d/lab.conf" <<EOF
[Service]
WatchdogSec=4
TimeoutAbortSec=1
StandardError=append:/run/pitchd.log
EOF
cat > "$root/etc/systemd/system/lab.target" <<EOF
[Unit]
Wants=camera.service pitchd.service
EOF
: > "$root/etc/machine-id"
echo ready
exec chroot "$root" /usr/bin/env -i container=lab PATH=/usr/sbin:/usr/bin:/sbin:/bin \
    /lib/systemd/systemd --system --unit=lab.target --log-target=null --show-status=no
