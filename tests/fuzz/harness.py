"""One decoder under atheris: `python -m tests.fuzz.harness NAME CORPUS [LIBFUZZER OPTIONS]`; see campaign.py."""

from __future__ import annotations

import sys
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["upwash"]):
    from tests.fuzz.decoders import decoders


def main() -> None:
    _, name, corpus, *options = sys.argv
    decoder = decoders()[name]
    for number, data in enumerate(decoder.understood):
        Path(corpus, f"understood-{number}").write_bytes(data)
    atheris.Setup([sys.argv[0], *options, corpus], decoder.feed)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
