"""MAVLink: framing, codec, frame conversion, signing, allow list, telemetry, transport, log."""
