#!/bin/sh
# Makes a Debian machine (12 or newer) an edge server, under systemd. Run it again for another version of upwash: it leaves
# the configuration and the keys as they are.
#
#   sudo deploy/install.sh NAME KEYS [detector-gpu]
#   sudo PYTHON=/usr/bin/python3.12 deploy/install.sh NAME KEYS    # default: python3; 3.11 or newer
#
# NAME is the server's, as in its certificate, and KEYS the folder of `upwash keys KEYS --server NAME ...`, made before on
# a computer of your own: of it the server gets authority.pem, NAME.pem, NAME.key and revoked.txt. With detector-gpu the
# detector computes on an NVIDIA card (docs/small-computers.md), with detector on the processor; default: as before.
set -eu

name=${1:?usage: install.sh NAME KEYS [detector-gpu]}
keys=${2:?usage: install.sh NAME KEYS [detector-gpu]}
source=$(dirname "$(dirname "$(readlink -f "$0")")")
root=${DESTDIR:+$(readlink -m "$DESTDIR")}  # where a package is made of what this installs, for another machine
home=$root/opt/upwash
settings=$root/etc/upwash
python=${PYTHON:-python3}
unit=$root/etc/systemd/system/upwash.service
card='devices = ["nvidia.com/gpu=all"]'

fail() {
    echo "install.sh: $1" >&2
    exit 1
}

[ -n "$root" ] || [ "$(id -u)" -eq 0 ] || fail "this needs root: sudo $0 $name $keys"
command -v apt-get >/dev/null || fail "no apt-get here: this is for Debian; docs/servers.md has the steps for others"
case $name in [!A-Za-z0-9]* | *[!A-Za-z0-9._-]* | "")
    fail "the name of a server has letters, digits, '.', '_' and '-', first a letter or a digit, not \"$name\"" ;;
esac
case ${3:-detector} in detector | detector-gpu) ;; *) fail "the third word is detector or detector-gpu, not \"$3\"" ;; esac
for file in authority.pem "$name.pem" "$name.key"; do
    [ -f "$keys/$file" ] || [ -f "$settings/keys/$file" ] ||
        fail "no $keys/$file: make the keys on your own computer, with upwash keys $keys --server $name --drone d1"
done

apt-get install --yes python3-venv bubblewrap
[ -x "$home/bin/pip" ] && python=$home/bin/python
echo "upwash gets $("$python" --version) of $(readlink -f "$(command -v "$python")")"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    fail "that is too old: name Python 3.11 or newer in PYTHON, and remove $home if it is there"
[ -x "$home/bin/pip" ] || "$python" -m venv "$home"
there=detector  # or, where onnxruntime-gpu is installed in place of onnxruntime, what keeps it
ls -d "$home"/lib/python3*/site-packages/onnxruntime_gpu-*.dist-info >/dev/null 2>&1 && there=detector-gpu
detector=${3:-$there}
if [ "$detector" != "$there" ]; then  # each would overwrite files of the other
    "$home/bin/python" -m pip uninstall --yes onnxruntime onnxruntime-gpu
fi
"$home/bin/python" -m pip install --upgrade --constraint "$source/deploy/constraints.txt" "$source[$detector,metrics]"
if [ -n "$root" ]; then  # the scripts name their Python
    grep -rlIFZ "$home" "$home/bin" "$home/pyvenv.cfg" | xargs -0 sed -i "s|$home|/opt/upwash|g"
fi

user='useradd --system --home-dir /nonexistent --shell /usr/sbin/nologin upwash'
[ -n "$root" ] || id upwash >/dev/null 2>&1 || $user
[ -n "$root" ] || runuser --user upwash -- "$home/bin/upwash" --version >/dev/null ||
    fail "the user upwash cannot run $home/bin/upwash: remove $home, and name in PYTHON one that every user can run"
group=$(id -gn upwash 2>/dev/null || id -gn)
install -d -m 750 -g "$group" "$settings" "$settings/keys"
for file in authority.pem "$name.pem" "$name.key" revoked.txt; do
    [ -f "$settings/keys/$file" ] || [ ! -f "$keys/$file" ] ||
        install -m 640 -g "$group" "$keys/$file" "$settings/keys"
done
[ -f "$settings/keys/revoked.txt" ] || install -m 640 -g "$group" /dev/null "$settings/keys/revoked.txt"

if [ ! -f "$settings/server.toml" ]; then
    cat >"$settings/server.toml" <<TOML
listen = "0.0.0.0:7070"
instance_ports = [7100, 7119]

[runtime]
sandbox = "required"

[keys]
authority = "keys/authority.pem"
certificate = "keys/$name.pem"
key = "keys/$name.key"
revoked = "keys/revoked.txt"

[[service]]
name = "detector"

[[server]]
name = "$name"
TOML
    [ "$detector" = detector ] || sed -i "s|^name = \"detector\"\$|&\n$card|" "$settings/server.toml"
    chmod 644 "$settings/server.toml"
elif [ "${3:-}" = detector-gpu ] && ! grep -q nvidia "$settings/server.toml"; then
    echo "to show the card to the detector, add below its name in $settings/server.toml: $card"
fi

was_there=$([ -f "$unit" ] && echo yes || echo no)
install -d "$root/etc/systemd/system"
install -m 644 "$source/deploy/upwash.service" "$unit"
if [ "${3:-}" = detector-gpu ]; then
    install -d "$unit.d"
    install -m 644 "$source/deploy/upwash-gpu.conf" "$unit.d/gpu.conf"
fi
if [ -n "$root" ]; then
    echo "installed below $root: nothing was started. There it takes, as root:"
    echo "$user && chgrp -R upwash /etc/upwash && systemctl enable --now upwash"
    exit 0
fi
systemctl daemon-reload
if [ "$was_there" = yes ] && systemctl is-active --quiet upwash; then
    systemctl kill --kill-whom=main --signal=SIGUSR2 upwash
    echo "upwash has been told to take its own place: drones call on; journalctl --unit upwash says what came of it"
else
    systemctl enable --now upwash
    echo "$name is ready at port 7070; its settings are in /etc/upwash/server.toml"
fi
