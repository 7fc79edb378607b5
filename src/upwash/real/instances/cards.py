"""NVIDIA's graphics cards: the device files behind a name, and what CUDA needs in a sandbox besides them.

The needs were collected from reports about other sandboxes, and suffice on an H200 (docs/decisions/sandbox.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from upwash.config.runtime import NVIDIA_CARD

_DEVICES = "/dev/nvidia"
_NEEDED = (f"{_DEVICES}ctl", f"{_DEVICES}-uvm")
_OPTIONAL = f"{_DEVICES}-uvm-tools"
# Here CUDA looks whether the driver is loaded, and which processors and memory are near a card.
_KERNEL = (
    "/sys/module/nvidia",
    "/sys/module/nvidia_uvm",
    "/sys/devices/system/memory",
    "/sys/devices/system/node",
)
_CARDS = Path("/proc/driver/nvidia/gpus")  # a folder for each, named by its place on the PCI bus


def device_files(devices: Iterable[str]) -> tuple[str, ...]:
    """The paths of devices; a name of the Container Device Interface stands for an NVIDIA card, or for all."""
    files = [file for device in devices for file in _files_of(device)]
    return tuple(dict.fromkeys(files))


def has_card(devices: Iterable[str]) -> bool:
    """Whether one of the devices is an NVIDIA card."""
    return any(device.startswith(_DEVICES) for device in devices)


def read_by_cuda() -> list[str]:
    """The files and folders of the kernel that CUDA reads; a machine may lack some."""
    places = sorted(path.name for path in _CARDS.glob("*"))
    return [*_KERNEL, *(f"/sys/bus/pci/devices/{place}" for place in places)]


def _files_of(device: str) -> Iterator[str]:
    named = NVIDIA_CARD.fullmatch(device)
    if named is None:
        yield device
        return
    if named[1] == "all":
        cards = sorted(path.name for path in Path("/dev").glob("nvidia[0-9]*"))
        yield from (f"/dev/{name}" for name in cards or ["nvidia0"])
    else:
        yield f"{_DEVICES}{named[1]}"
    yield from _NEEDED
    if Path(_OPTIONAL).exists():
        yield _OPTIONAL
