"""The setpoint benchmark: gaps of the stream at the receiver, under load."""
