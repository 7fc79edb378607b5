"""What a vehicle says in words, as it reaches logs and people."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.real.mavlink.telemetry import VehicleTelemetry


def said(*texts: bytes, number: int = 0) -> list[str]:
    telemetry = VehicleTelemetry()
    for chunk, text in enumerate(texts):
        sent = mavlink.MAVLink_statustext_message(4, text, number, chunk % 256)
        wire = mavlink.MAVLink(None, 1, 1)
        telemetry.take(wire.parse_char(sent.pack(mavlink.MAVLink(None, 1, 1))), 1.0)
    return [text.text for _, text in telemetry.texts]


def test_control_characters_of_a_vehicle_become_escapes() -> None:
    assert said(b"\x1b[2Jall\r\n\x7f") == [r"\x1b[2Jall\r\n\x7f"]


def test_a_text_without_end_is_taken_in_parts() -> None:
    texts = said(*[b"x" * 50] * 255, number=7)
    assert [len(text) for text in texts] == [1000] * (255 // 20)
