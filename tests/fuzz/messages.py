"""Well-formed messages of any kind, by a seed: whatever somebody with the vehicle's identity may say."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink import px4

_FLOATS = 0.0, -0.0, 1.0, -1.0, 359.0, 1e-45, 1e38, -1e38, float("nan"), float("inf"), float("-inf")
_ENDS = 0, 1, -1, 2, 3, 127, 128, 255, 2**15 - 1, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1
_TEXTS = b"\x1b", b"A", b"\xff", b"\0", b"\n", "\u202e".encode()
_OWN = px4.EventMessage, px4.CurrentModeMessage, px4.AvailableModesMessage
_LAYOUT = {"B": "uint8_t", "H": "uint16_t", "I": "uint32_t"}


def messages(seed: int, *, but: frozenset[str] = frozenset()) -> Iterator[Any]:
    """Messages without end, of all kinds but those."""
    chance = random.Random(seed)
    kinds = [*(kind for kind in mavlink.mavlink_map.values() if kind.msgname not in but), *_OWN]
    while True:
        kind = chance.choice(kinds)
        yield _own(kind, chance) if kind in _OWN else _of_dialect(kind, chance)


def _of_dialect(kind: Any, chance: random.Random) -> Any:
    values: list[Any] = []
    for name, type_name in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        length = kind.array_lengths[kind.ordered_fieldnames.index(name)]
        if type_name == "char":
            values.append(b"".join(chance.choice(_TEXTS) for _ in range(max(length, 1)))[: max(length, 1)])
        else:
            numbers = [_number(type_name, chance) for _ in range(max(length, 1))]
            values.append(numbers if length else numbers[0])
    return kind(*values)


def _own(kind: Any, chance: random.Random) -> Any:
    values = [
        chance.randbytes(int(code[:-1])) if code.endswith("s") else _number(_LAYOUT[code], chance)
        for code in re.findall(
            r"\d+s|[BHI]", kind.unpacker.format.replace("IIB", "I I B").replace("II", "I I")
        )
    ]
    message = kind(**dict(zip(kind.fieldnames, values, strict=True)))
    if kind is px4.EventMessage and chance.random() < 0.8:
        message.id_of_event = chance.choice(tuple(px4.px4_events()))
    return message


def _number(type_name: str, chance: random.Random) -> Any:
    if type_name in ("float", "double"):
        return chance.choice(_FLOATS)
    bits, is_signed = int("".join(filter(str.isdecimal, type_name))), type_name.startswith("int")
    number = chance.choice((*_ENDS, -chance.choice(_ENDS), chance.getrandbits(bits)))
    least, most = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if is_signed else (0, 2**bits - 1)
    return min(max(number, least), most)
