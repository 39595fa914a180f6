#!/bin/sh
# Turns fresh mount, pid, ipc, uts, cgroup and network namespaces into a machine of their own: this machine's files under
# a layer in memory that takes all changes, an empty /etc/systemd/system, own /dev, /run and /tmp, and systemd as the
# first process. tests/machine.rs makes the namespaces and calls it with an empty directory.
set -eu
dir=$1
root=$dir/root
mount --make-rprivate /

mkdir "$dir/layer" "$root"
mount -t tmpfs -o mode=755 layer "$dir/layer"
mkdir "$dir/layer/changed" "$dir/layer/work"
mount -t overlay -o "lowerdir=/,upperdir=$dir/layer/changed,workdir=$dir/layer/work" overlay "$root"

# What the kernel shows. sysfs is read-only: systemd then leaves devices alone.
mount -t proc proc "$root/proc"
mount -t sysfs -o ro sysfs "$root/sys"
mount -t cgroup2 cgroup2 "$root/sys/fs/cgroup"
for name in run tmp; do
    mount -t tmpfs -o mode=1777 "$name" "$root/$name"
done
chmod 755 "$root/run"

dev=$root/dev
mount -t tmpfs -o mode=755 dev "$dev"
for node in "null 3" "zero 5" "full 7" "random 8" "urandom 9"; do
    mknod -m 666 "$dev/${node% *}" c 1 "${node#* }"
done
mkdir "$dev/shm" "$dev/pts"
mount -t tmpfs -o mode=1777 shm "$dev/shm"
mount -t devpts -o newinstance,ptmxmode=0666,mode=620,gid=5 devpts "$dev/pts"
ln -s pts/ptmx "$dev/ptmx"
ln -s /proc/self/fd "$dev/fd"
touch "$dir/console" "$dev/console"
mount --bind "$dir/console" "$dev/console"

# Nothing of this machine's own services starts there: systemd boots up to its journal and D-Bus, and that is all.
units=$root/etc/systemd/system
find "$units" -mindepth 1 -delete
for unit in dev-hugepages.mount getty.target ldconfig.service modprobe@.service proc-sys-fs-binfmt_misc.automount \
    sys-fs-fuse-connections.mount sys-kernel-debug.mount sys-kernel-tracing.mount systemd-binfmt.service \
    systemd-firstboot.service systemd-hwdb-update.service systemd-journald-audit.socket systemd-logind.service \
    systemd-modules-load.service systemd-network-generator.service systemd-networkd.service systemd-resolved.service \
    systemd-sysctl.service systemd-timesyncd.service systemd-udev-trigger.service systemd-udevd.service \
    systemd-update-utmp.service; do
    ln -s /dev/null "$units/$unit"
done
cat > "$units/test.target" <<UNIT
[Unit]
Requires=sysinit.target
After=sysinit.target
Wants=dbus.socket
AllowIsolate=yes
UNIT
# A cell that this machine may have is none of that one's.
rm -rf "$root/var/lib/packcell" "$root/etc/packcell"
echo uninitialized > "$root/etc/machine-id"
echo packcell-test > "$root/etc/hostname"
# Containers are told by this file not to start services that are installed; this one is to.
rm -f "$root/usr/sbin/policy-rc.d"

mkdir "$root/old"
cd "$root"
pivot_root . old
umount -l /old
rmdir /old
mount --make-rshared /
exec env -i container=test PATH=/usr/sbin:/usr/bin:/sbin:/bin /lib/systemd/systemd --system --unit=test.target \
    --log-target=journal --show-status=no < /dev/null > /dev/console 2>&1
