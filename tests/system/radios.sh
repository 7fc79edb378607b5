#!/bin/sh
# radios.sh FOLDER
# A real NetworkManager with two radios, radio1 and radio2, that are cables to servers s1 and s2, all in namespaces of
# its own. Says "ready" once the manager is. Each line that it reads starts the manager anew; when there are no more it
# ends, and everything in it. (No namespace of processes: the manager asks /proc who calls.)
set -eu
PATH=$PATH:/usr/sbin:/sbin
folder=$1
if [ "${2:-}" != inside ]; then
    exec unshare --net --mount -- "$0" "$folder" inside "$(readlink /proc/self/ns/net)"
fi
[ "$(readlink /proc/self/ns/net)" != "$3" ] || exit 1 # never near the machine's own interfaces

mortal="setpriv --pdeathsig KILL" # what it starts does not outlive this script, however that ends

mount -t sysfs -o ro sysfs /sys # of this namespace's devices; read-only, so that nobody waits for udev
mount -t tmpfs -o mode=755 tmpfs /run
mkdir -p /run/netns /run/field /etc/polkit-1/rules.d "$folder/etc/system-connections" "$folder/lib" /etc/NetworkManager /var/lib/NetworkManager
mount --bind "$folder/etc" /etc/NetworkManager
mount --bind "$folder/lib" /var/lib/NetworkManager
mount --bind "$folder/rules.d" /etc/polkit-1/rules.d
mount --bind "$folder" /run/field # for users who may not enter the folders above it
ip link set lo up
for i in 1 2; do
    ip netns add s$i
    ip -n s$i link set lo up
    ip link add radio$i type veth peer name ap$i netns s$i
    ip -n s$i addr add 10.91.$i.1/24 dev ap$i
    ip -n s$i link set ap$i up
    ip netns exec s$i $mortal dnsmasq --keep-in-foreground --conf-file=/dev/null --port=0 --bind-interfaces --interface=ap$i \
        --dhcp-range=10.91.$i.50,10.91.$i.99,1h --dhcp-leasefile="$folder/leases$i" --dhcp-authoritative --no-ping \
        --dhcp-option=3 --pid-file="$folder/dnsmasq$i.pid" --user= --group= 2>"$folder/dnsmasq$i.log" &
    cat >"$folder/etc/system-connections/s$i-net.nmconnection" <<PROFILE
[connection]
id=s$i-net
uuid=00000000-0000-4000-8000-00000000000$i
type=ethernet
autoconnect=false
interface-name=radio$i
[ipv4]
method=auto
dhcp-timeout=2
never-default=true
[ipv6]
method=disabled
PROFILE
done
chmod 600 "$folder"/etc/system-connections/*
cat >"$folder/etc/NetworkManager.conf" <<CONF
[main]
plugins=keyfile
no-auto-default=*
dns=none
rc-manager=unmanaged
systemd-resolved=false
auth-polkit=true
dhcp=internal
hostname-mode=none
[keyfile]
unmanaged-devices=*,except:interface-name:radio*
[connectivity]
enabled=false
CONF
cat >"$folder/bus.conf" <<CONF
<busconfig><type>system</type><listen>unix:path=$folder/bus</listen><auth>EXTERNAL</auth>
<policy context="default"><allow user="*"/><allow own="*"/><allow send_destination="*"/><allow receive_sender="*"/></policy>
</busconfig>
CONF
export DBUS_SYSTEM_BUS_ADDRESS="unix:path=$folder/bus"
$mortal dbus-daemon --nofork --nopidfile --config-file="$folder/bus.conf" 2>"$folder/bus.log" &
until [ -S "$folder/bus" ]; do sleep 0.01; done
DBUS_SYSTEM_BUS_ADDRESS=unix:path=/run/field/bus /usr/lib/polkit-1/polkitd >"$folder/polkit.log" 2>&1 & # ends with the bus
start_manager() {
    rm -f /run/NetworkManager/NetworkManager.pid
    $mortal NetworkManager --debug --config="$folder/etc/NetworkManager.conf" >>"$folder/manager.log" 2>&1 &
    echo $! >"$folder/manager.pid"
    until [ "$(nmcli -t -f STARTUP general 2>/dev/null)" = started ]; do
        kill -0 "$(cat "$folder/manager.pid")" || exit 1
        sleep 0.02
    done
    echo ready
}
start_manager
while read -r _; do start_manager; done
