"""MAVLink as the driver and the stand-in both speak it, where pymavlink is not enough.

- `packets`: messages from bytes and back; garbage is skipped and never raises.
- `signing`: signatures of packets, made and judged. Each refusal has a reason for people.
- `px4`: PX4's events, modes and the messages that pymavlink's dialect lacks.
- `ftp`: the payload of file transfers. `version`, `connection`, `names`: how people and messages write those.

Nothing here has a socket or decides anything.

Ugly: `px4` fills private fields of pymavlink's messages, since pymavlink cannot parse a message outside its dialect.
"""
