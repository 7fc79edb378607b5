"""The filter of system calls for a service in a sandbox, in the format that bubblewrap reads.

Namespaces hide named objects. The filter refuses the rest: sockets to the host of a virtual machine, memory that no
limit counts, and parts of the kernel that only attackers need. Without a table for the processor there is no sandbox.
"""

from __future__ import annotations

import errno
import platform
import socket
import struct
from collections.abc import Iterable, Mapping

from upwash.errors import UsageError

# Of linux/audit.h, linux/seccomp.h, linux/bpf_common.h, linux/mman.h and linux/sched.h:
_LOAD, _AND, _EQUAL, _AT_LEAST, _ANSWER = 0x20, 0x54, 0x15, 0x35, 0x06
# Offsets in struct seccomp_data, where an argument has 8 bytes.
_NUMBER, _ARCHITECTURE, _FIRST_ARGUMENT = 0, 4, 16
_ALLOW, _REFUSE, _KILL = 0x7FFF0000, 0x00050000, 0x80000000
_NEW_NAMESPACES = 0x7E020000
_SHARED, _ANONYMOUS, _GROWS_DOWN = 0x01, 0x20, 0x100
_ROUTES = 0  # the netlink protocol of getaddrinfo()

# Each name's number on x86_64 and on aarch64. Linux numbers calls alike on both from 424 on.
_CALLS: Mapping[str, tuple[int, int]] = {
    "mmap": (9, 222),
    "socket": (41, 198),
    "socketpair": (53, 199),
    "clone": (56, 220),
    "sched_setaffinity": (203, 122),
}
_REFUSED: Mapping[int, Mapping[str, tuple[int, int]]] = {
    errno.EPERM: {
        "add_key": (248, 217),
        "bpf": (321, 280),
        "kcmp": (312, 272),
        "keyctl": (250, 219),
        "perf_event_open": (298, 241),
        "pidfd_getfd": (438, 438),
        "process_vm_readv": (310, 270),
        "process_vm_writev": (311, 271),
        "ptrace": (101, 117),
        "request_key": (249, 218),
        "setns": (308, 268),
        "syslog": (103, 116),
        "unshare": (272, 97),
        "userfaultfd": (323, 282),
    },
    # As on an older kernel, which libraries handle. Filters do not see the flags of clone3, io_uring bypasses
    # them, and the others give memory that RLIMIT_DATA does not count.
    errno.ENOSYS: {
        "clone3": (435, 435),
        "io_uring_enter": (426, 426),
        "io_uring_register": (427, 427),
        "io_uring_setup": (425, 425),
        "memfd_create": (319, 279),
        "memfd_secret": (447, 447),
        "shmget": (29, 194),
    },
}
_SHARING = "memfd_create"
_FAMILIES = (socket.AF_UNIX, socket.AF_INET, socket.AF_INET6)
_MACHINES = {
    "x86_64": (0xC000003E, 0),
    "aarch64": (0xC00000B7, 1),
}  # architecture, column of the tables above
_FIRST_OF_OTHERS = 0x40000000  # numbers from here on are another kind of processor's


def call_filter(machine: str = "", *, pins: bool = False, shares: bool = False) -> bytes:
    """The filter for this machine's processor, or for that `machine`; raises UsageError for an unknown one.

    With `pins` a process cannot choose other processors. With `shares` it can share memory without a file.
    """
    machine = machine or platform.machine()
    if machine not in _MACHINES:
        raise UsageError(f"no filter of system calls is known for a processor of the kind {machine}")
    return b"".join(_instructions(*_MACHINES[machine], pins=pins, shares=shares))


def _instructions(architecture: int, column: int, *, pins: bool, shares: bool) -> Iterable[bytes]:
    yield _step(_LOAD, _ARCHITECTURE)
    yield from _unless(architecture, [_answer(_KILL)])
    yield _step(_LOAD, _NUMBER)
    yield from _where(_AT_LEAST, _FIRST_OF_OTHERS, [_refuse(errno.ENOSYS)])
    for error, calls in _REFUSED.items():
        for name, numbers in calls.items():
            if shares and name == _SHARING:
                continue
            yield from _where(_EQUAL, numbers[column], [_refuse(error)])
    if pins:
        yield from _where(_EQUAL, _CALLS["sched_setaffinity"][column], [_refuse(errno.EPERM)])
    for name, rules in {
        "clone": _rules_of_clone(),
        "mmap": _rules_of_mmap(shares=shares),
        "socket": _rules_of_sockets(),
        "socketpair": _rules_of_sockets(),
    }.items():
        yield from _where(_EQUAL, _CALLS[name][column], [*rules, _answer(_ALLOW)])
    yield _answer(_ALLOW)


def _rules_of_clone() -> list[bytes]:
    return [_argument(0), _step(_AND, _NEW_NAMESPACES), *_unless(0, [_refuse(errno.EPERM)])]


def _rules_of_mmap(*, shares: bool) -> list[bytes]:
    """Refuse memory that RLIMIT_DATA does not count: shared without a file, or a stack."""
    shared = [
        _argument(3),
        _step(_AND, _SHARED | _ANONYMOUS),
        *_where(_EQUAL, _SHARED | _ANONYMOUS, [_refuse(errno.ENOMEM)]),
    ]
    return [
        *(() if shares else shared),
        _argument(3),
        _step(_AND, _GROWS_DOWN),
        *_unless(0, [_refuse(errno.ENOMEM)]),
    ]


def _rules_of_sockets() -> list[bytes]:
    """Allow the socket families that services need and network namespaces confine."""
    return [
        _argument(0),
        *(step for family in _FAMILIES for step in _where(_EQUAL, family, [_answer(_ALLOW)])),
        *_unless(socket.AF_NETLINK, [_refuse(errno.EAFNOSUPPORT)]),
        _argument(2),
        *_unless(_ROUTES, [_refuse(errno.EAFNOSUPPORT)]),
    ]


def _where(test: int, value: int, then: list[bytes]) -> list[bytes]:
    return [_step(test, value, 0, len(then)), *then]


def _unless(value: int, then: list[bytes]) -> list[bytes]:
    return [_step(_EQUAL, value, len(then), 0), *then]


def _argument(index: int) -> bytes:
    """Load the lower half of an argument, which has all the bits that matter here."""
    return _step(_LOAD, _FIRST_ARGUMENT + 8 * index)


def _refuse(error: int) -> bytes:
    return _answer(_REFUSE | error)


def _answer(answer: int) -> bytes:
    return _step(_ANSWER, answer)


def _step(operation: int, value: int, if_so: int = 0, if_not: int = 0) -> bytes:
    """One struct sock_filter; `if_so` and `if_not` are how many instructions a test skips."""
    return struct.pack("HBBI", operation, if_so, if_not, value)
