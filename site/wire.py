"""Writes the test vectors of docs/services.md from the code: `python site/wire.py`."""

from __future__ import annotations

import runpy
from pathlib import Path

import msgspec

from upwash.real.instances.foreign import ProgramAnswer, ProgramCall, ProgramSettings
from upwash.real.link.direct import frame
from upwash.rpc.service import ServiceFault, spec_of

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "services.md"
BEGIN, END = "<!-- written by site/wire.py -->\n", "<!-- end -->"
PHOTO = bytes([0, 0, 255, 255])


def vectors() -> list[tuple[str, bytes]]:
    """The frames of a short conversation with the example's program, and their senders."""
    example = runpy.run_path(str(ROOT / "examples" / "other-languages" / "detail.py"))
    method = spec_of(example["Detail"]).methods["measure"]
    _, asked = method.encode((PHOTO,), {})
    _, nothing = method.encode((b"",), {})
    value = msgspec.msgpack.encode(example["Detail"]().measure(PHOTO))
    fault = ServiceFault("builtins:ValueError", "the photo is empty")
    return [
        ("instance", frame(ProgramSettings({"blank_below": 0.5}))),
        ("program", frame(ProgramAnswer(0, msgspec.Raw(msgspec.msgpack.encode(None))))),
        ("instance", frame(ProgramCall(1, "measure", msgspec.Raw(asked)))),
        ("program", frame(ProgramAnswer(1, msgspec.Raw(value)))),
        ("instance", frame(ProgramCall(2, "measure", msgspec.Raw(nothing)))),
        ("program", frame(ProgramAnswer(2, fault=fault))),
    ]


def page() -> str:
    """The page as it should be."""
    head, _, rest = PAGE.read_text().partition(BEGIN)
    return head + BEGIN + "".join(_block()) + END + rest.partition(END)[2]


def _block() -> list[str]:
    lines = []
    for who, sent in vectors():
        shown = msgspec.json.encode(msgspec.msgpack.decode(sent[4:])).decode()
        written = "\n".join(sent.hex()[at : at + 96] for at in range(0, len(sent.hex()), 96))
        lines.append(f"\nThe {who} writes `{shown}`\n\n```\n{written}\n```\n")
    return [*lines, "\n"]


if __name__ == "__main__":
    PAGE.write_text(page())
